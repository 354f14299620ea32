"""`rasterize` and `descend`, on whatever device the tensors live, and `rasterize_reference`."""

from __future__ import annotations

import torch
from torch import Tensor

from twin_node.splat import library as native
from twin_node.splat.arguments import (
    Gaussians,
    Options,
    RasterizeMode,
    RasterMeta,
    Rendered,
    RenderMode,
    Scene,
    Views,
    check_finite,
    check_shapes,
)
from twin_node.splat.captured_descent import descend_captured
from twin_node.splat.cpu import render_native
from twin_node.splat.cuda import render_gsplat
from twin_node.splat.descent import descend_compiled
from twin_node.splat.learning import Aims, Bystanders, Course, Descended, Learners, require_layouts
from twin_node.splat.reference import render_reference


def rasterize(
    means: Tensor,  # [..., N, 3]
    quats: Tensor,  # [..., N, 4] w, x, y, z
    scales: Tensor,  # [..., N, 3]
    opacities: Tensor,  # [..., N]
    colors: Tensor,  # [..., (C,) N, D] or [..., (C,) N, K, 3]
    viewmats: Tensor,  # [..., C, 4, 4]
    Ks: Tensor,  # [..., C, 3, 3]
    width: int,
    height: int,
    *,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    eps2d: float = 0.3,
    sh_degree: int | None = None,
    backgrounds: Tensor | None = None,  # [..., C, D]
    render_mode: RenderMode = "RGB",
    rasterize_mode: RasterizeMode = "classic",
    pixel_mask: Tensor | None = None,  # [..., C, H, W] bool
) -> tuple[Tensor, Tensor, RasterMeta]:
    """Draws 3D Gaussians into a batch of pinhole images, with the arguments and semantics of `gsplat.rasterization`.

    Shapes stand beside the arguments; C cameras draw N Gaussians, for every index of the leading dimensions. So that
    each camera can see them at a time of its own, give means [C, N, 3] with viewmats [C, 1, 4, 4]; what all share may
    come without the leading dimensions, quats [N, 4] say, and is not copied. Lengths are in the units of the means,
    `scales` are linear, `opacities` 0 to 1, Ks and `radius_clip` in pixels, `eps2d` in pixels^2.

    Gives (renders, alphas, meta): renders [..., C, H, W, X] with X = D, the depth being the last channel where
    `render_mode` asks for it; alphas [..., C, H, W, 1]. Gradients reach means, quats, scales, opacities, colors,
    viewmats and backgrounds. Pixels outside `pixel_mask` cost nothing in either direction: they come back as the
    background (zero without one) with alpha 0, and send back no gradient.

    On the CPU the compiled library does it (float32; plain torch where it cannot be compiled, with one warning), on
    CUDA gsplat does. The CPU's result is the same to the bit for any number of threads.

    Raises:
        ValueError: an argument has a wrong shape, dtype or device, or is empty or not finite; the message names it.
        SplatError: CUDA tensors without all that gsplat needs, or a call in a forked child.
    """
    gaussians = Gaussians(means, quats, scales, opacities, colors)
    views = Views(viewmats, Ks, width, height, backgrounds, pixel_mask)
    options = Options(near_plane, far_plane, radius_clip, eps2d, sh_degree, render_mode, rasterize_mode)
    rendered = _render(check_shapes(gaussians, views, options))
    return rendered.renders, rendered.alphas, rendered.meta


def rasterize_reference(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    colors: Tensor,
    viewmats: Tensor,
    Ks: Tensor,
    width: int,
    height: int,
    *,
    near_plane: float = 0.01,
    far_plane: float = 1e10,
    radius_clip: float = 0.0,
    eps2d: float = 0.3,
    sh_degree: int | None = None,
    backgrounds: Tensor | None = None,
    render_mode: RenderMode = "RGB",
    rasterize_mode: RasterizeMode = "classic",
    pixel_mask: Tensor | None = None,
) -> tuple[Tensor, Tensor, RasterMeta]:
    """`rasterize` in plain torch, float32 or float64, on any device: the reference of the tests.

    Arguments, results and `ValueError` as there.
    """
    gaussians = Gaussians(means, quats, scales, opacities, colors)
    views = Views(viewmats, Ks, width, height, backgrounds, pixel_mask)
    options = Options(near_plane, far_plane, radius_clip, eps2d, sh_degree, render_mode, rasterize_mode)
    scene = check_shapes(gaussians, views, options)
    check_finite(scene)
    rendered = render_reference(scene)
    return rendered.renders, rendered.alphas, rendered.meta


def can_descend(device: torch.device) -> bool:
    """Whether `descend` takes tensors on this device."""
    return device.type == "cuda" or native.has_kernels(device)


def descend(learners: Learners, bystanders: Bystanders, aims: Aims, course: Course) -> Descended:
    """Takes steps of Adam down `image_loss` (L1, of depth too) of what is seen.

    Gaussians that nothing pulls at are left alone; those that would not stay finite keep their values and forget their
    moments. Float32 tensors on the CPU, where one call of the compiled library does it, or on CUDA, where recorded
    graphs of gsplat's kernels do.
    Raises `ValueError` naming a target that is not finite, what is of another shape or kind or, of what is brought up
    to date, in pieces, for no steps, or where the library is not at hand (see `can_descend`); `SplatError` for CUDA
    tensors without all that gsplat needs.
    """
    if course.steps < 1:
        raise ValueError(f"steps: expected 1 or more, found {course.steps}")
    require_layouts(learners, bystanders, aims)
    if learners.values.device.type == "cuda":
        return descend_captured(learners, bystanders, aims, course)
    library = native.kernels()
    if library is None:
        raise ValueError("descend: the compiled library is not at hand; see can_descend")
    return descend_compiled(learners, bystanders, aims, course, library)


def _render(scene: Scene) -> Rendered:
    dtype = scene.gaussians.means.dtype
    if dtype != torch.float32:
        raise ValueError(f"means: expected float32 (rasterize_reference takes float64 too), found {dtype}")
    if scene.gaussians.means.is_cuda:
        check_finite(scene)
        return render_gsplat(scene)
    library = native.kernels_for(scene.gaussians.means.device)
    if library is None:
        check_finite(scene)
        return render_reference(scene)
    return render_native(scene, library)
