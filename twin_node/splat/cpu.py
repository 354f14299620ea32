"""The compiled CPU backend as a differentiable torch operation."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, cast

import torch
from torch import Tensor
from torch.autograd.function import once_differentiable

from twin_node.native_library import thread_count
from twin_node.splat import library as native
from twin_node.splat.arguments import RasterMeta, Rendered, Scene, require_finite
from twin_node.splat.request import fill, new_request, not_finite_is_named
from twin_node.splat.semantics import Semantics, installed_semantics


@dataclass(frozen=True)
class _Inputs:
    """Contiguous tensors that the library reads, in the order in which it counts the ones it checks."""

    means: Tensor
    quats: Tensor
    scales: Tensor
    opacities: Tensor
    colors: Tensor
    viewmats: Tensor
    Ks: Tensor
    backgrounds: Tensor | None
    """[..., C, channels]."""
    pixel_mask: Tensor | None
    """[..., C, H, W] bool; never checked."""

    @classmethod
    def of(cls, *given: Tensor | None) -> _Inputs:
        """Of tensors that need not be contiguous, in this order."""
        return cls(*(None if t is None else t.contiguous() for t in given))  # type: ignore[arg-type]


@dataclass(frozen=True)
class _Images:
    """What the library draws, or gradients of it."""

    renders: Tensor
    """[..., C, H, W, channels]."""
    alphas: Tensor
    """[..., C, H, W, 1]."""


def render_native(scene: Scene, library: native.SplatLibrary, semantics: Semantics | None = None) -> Rendered:
    """Renders float32 CPU tensors with the compiled library. Raises `ValueError` naming what is not finite."""
    g, views = scene.gaussians, scene.views
    if not scene.options.with_color:
        require_finite({"colors": g.colors})  # which the library then never reads
    call = _Call(scene, library, semantics or installed_semantics())
    tensors = (g.means, g.quats, g.scales, g.opacities, g.colors, views.viewmats, views.Ks)
    behind = (_backgrounds(scene), views.pixel_mask)
    if not torch.is_grad_enabled():
        return call.render(_Inputs.of(*tensors, *behind))
    renders, alphas, radii, means2d, depths = _Rasterize.apply(call, *tensors, *behind)  # type: ignore[no-untyped-call]
    return Rendered(renders, alphas, RasterMeta(radii, means2d, depths))


def _backgrounds(scene: Scene) -> Tensor | None:
    """One value per rendered channel: zero behind the depth, and none at all where only depth is drawn."""
    backgrounds = scene.views.backgrounds
    if backgrounds is None or not scene.options.with_color:
        return None
    return torch.nn.functional.pad(backgrounds, (0, 1)) if scene.options.with_depth else backgrounds


class _Call:
    """One call on its way through autograd."""

    def __init__(self, scene: Scene, library: native.SplatLibrary, semantics: Semantics) -> None:
        self.scene = scene
        self.library = library
        self.semantics = semantics
        self.threads = thread_count()
        self.workspace = native.Workspace(library)

    def render(self, inputs: _Inputs) -> Rendered:
        """Runs the forward pass; the workspace then holds what `differentiate` needs."""
        scene = self.scene
        lead, like = scene.image_shape[:-2], inputs.means  # whatever torch makes by default
        rendered = Rendered(
            renders=like.new_empty(*scene.image_shape, scene.channels),
            alphas=like.new_empty(*scene.image_shape, 1),
            meta=RasterMeta(
                radii=like.new_empty(*lead, scene.count, 2, dtype=torch.int32),
                means2d=like.new_empty(*lead, scene.count, 2),
                depths=like.new_empty(*lead, scene.count),
            ),
        )
        request = self._request(inputs, _Images(rendered.renders, rendered.alphas), rendered.meta)
        with not_finite_is_named(vars(inputs)):
            self.library.forward(self.workspace, request)
        return rendered

    def differentiate(self, inputs: _Inputs, images: _Images, pulls: _Images, with_cameras: bool) -> _Inputs:
        """Gradients of the inputs; none for Ks, backgrounds and mask, zero for viewmats unless asked for.

        `inputs` and `images` hold what `render` took and gave, not always where it did: `saved_tensors_hooks` may give
        back copies. `pulls` are the images' gradients.
        """
        v = _Inputs(
            means=torch.zeros_like(inputs.means),
            quats=torch.zeros_like(inputs.quats),
            scales=torch.zeros_like(inputs.scales),
            opacities=torch.zeros_like(inputs.opacities),
            colors=torch.zeros_like(inputs.colors),
            viewmats=torch.zeros_like(inputs.viewmats),
            Ks=inputs.Ks.new_empty(0),
            backgrounds=None,
            pixel_mask=None,
        )
        gradients = fill(
            native.Gradients,
            v_renders=pulls.renders,
            v_alphas=pulls.alphas,
            v_means=v.means,
            v_quats=v.quats,
            v_scales=v.scales,
            v_opacities=v.opacities,
            v_colors=v.colors,
            v_viewmats=v.viewmats if with_cameras else None,
        )
        self.library.backward(self.workspace, self._request(inputs, images, None), gradients)
        return v

    def _request(self, inputs: _Inputs, images: _Images, meta: RasterMeta | None) -> native.Request:
        """The pointers in it are valid for as long as inputs and outputs are held; only a forward pass needs `meta`."""
        scene, options, views = self.scene, self.scene.options, self.scene.views
        harmonics = options.with_color and options.sh_degree is not None
        return new_request(
            options,
            self.semantics,
            batches=scene.batches,
            cameras=scene.cameras,
            gaussians=scene.count,
            width=views.width,
            height=views.height,
            color_channels=scene.channels - int(options.with_depth),
            sh_bases=int(inputs.colors.shape[-2]) if harmonics else 0,
            colors_per_camera=int(scene.colors_per_camera),
            threads=self.threads,
            **self._strides(inputs),
            **vars(inputs),
            renders=images.renders,
            alphas=images.alphas,
            **({} if meta is None else vars(meta)),
        )

    def _strides(self, inputs: _Inputs) -> dict[str, int]:
        """Floats from batch to batch; 0 for what all batches share."""
        ranks = {"means": 2, "quats": 2, "scales": 2, "opacities": 1, "colors": 1 + self.scene.color_rank}
        return {f"{name}_stride": self._stride(vars(inputs)[name], rank) for name, rank in ranks.items()}

    def _stride(self, tensor: Tensor, rank: int) -> int:
        return 0 if tensor.dim() == rank else tensor.numel() // self.scene.batches


class _Rasterize(torch.autograd.Function):
    """The library's two passes. Inputs: a `_Call`, then the fields of `_Inputs`."""

    @staticmethod
    def forward(ctx: Any, call: _Call, *tensors: Tensor | None) -> tuple[Tensor, ...]:
        inputs = _Inputs.of(*tensors)
        rendered = call.render(inputs)
        meta = rendered.meta
        if any(ctx.needs_input_grad):
            ctx.call = call
            ctx.save_for_backward(*vars(inputs).values(), rendered.renders, rendered.alphas)
        ctx.mark_non_differentiable(meta.radii, meta.means2d, meta.depths)
        ctx.set_materialize_grads(False)
        return rendered.renders, rendered.alphas, meta.radii, meta.means2d, meta.depths

    @staticmethod
    @once_differentiable
    def backward(ctx: Any, *gradients: Tensor | None) -> tuple[Tensor | None, ...]:
        call = cast(_Call, ctx.call)
        *saved, renders, alphas = ctx.saved_tensors
        inputs, images = _Inputs.of(*saved), _Images(renders.contiguous(), alphas.contiguous())
        v_renders = torch.zeros_like(renders) if gradients[0] is None else gradients[0].contiguous()
        v_alphas = torch.zeros_like(alphas) if gradients[1] is None else gradients[1].contiguous()
        pulls = _Images(v_renders, v_alphas)
        v = call.differentiate(inputs, images, pulls, with_cameras=ctx.needs_input_grad[6])
        v_backgrounds = _backgrounds_gradient(inputs.pixel_mask, v_renders, alphas) if ctx.needs_input_grad[8] else None
        fields = (v.means, v.quats, v.scales, v.opacities, v.colors, v.viewmats)
        return (None, *fields, None, v_backgrounds, None)


def _backgrounds_gradient(pixel_mask: Tensor | None, v_renders: Tensor, alphas: Tensor) -> Tensor:
    left = 1 - alphas
    if pixel_mask is not None:
        left = left * pixel_mask.unsqueeze(-1)
    return (v_renders * left).sum(dim=(-3, -2))
