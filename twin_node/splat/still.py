"""What one camera sees of Gaussians, by one call of the compiled library: an image, or how much each of them shows."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from twin_node.native_library import thread_count
from twin_node.splat import library as native
from twin_node.splat.arguments import Options, require_layout
from twin_node.splat.dispatch import rasterize
from twin_node.splat.request import Field, new_request, not_finite_is_named

_OPTIONS = Options(render_mode="RGB+ED")
_FIELDS = ("means", "quats", "scales", "opacities", "colors", "viewmats", "Ks")
"""What the library calls the tensors of a `Shot`."""


@dataclass(frozen=True)
class Shot:
    """n Gaussians and the camera that sees them, as `rasterize` takes them, in its order."""

    means: Tensor
    """[n, 3] m."""
    quats: Tensor
    """[n, 4] w, x, y, z."""
    scales: Tensor
    """[n, 3] m, linear."""
    opacities: Tensor
    """[n] 0 to 1."""
    rgb: Tensor
    """[n, 3] 0 to 1."""
    viewmat: Tensor
    """[4, 4]."""
    K: Tensor
    """[3, 3] pixels."""
    width: int
    height: int


def draw_still(shot: Shot) -> tuple[Tensor, Tensor]:
    """Colour and depth [H, W, 4], and alpha [H, W]; nothing is differentiated.

    Colour is 0 to 1, on black; depth is that expected along the optical axis, m, 0 where nothing is.
    Raises `ValueError` naming what is of another shape or not finite.
    """
    library = native.kernels_for(shot.means.device)
    if library is None:
        return draw_still_reference(shot)
    rgbd, alpha = _empty(shot, shot.height, shot.width, 4), _empty(shot, shot.height, shot.width)
    workspace = native.Workspace(library)
    _do(
        lambda request: library.forward(workspace, request),
        shot,
        _OPTIONS,
        renders=rgbd,
        alphas=alpha,
        color_channels=3,
    )
    return rgbd, alpha


def draw_still_reference(shot: Shot) -> tuple[Tensor, Tensor]:
    """The same by `rasterize`, on any device: the reference of `draw_still`."""
    if not len(shot.means):
        return shot.means.new_zeros(shot.height, shot.width, 4), shot.means.new_zeros(shot.height, shot.width)
    given = {**vars(shot), "viewmat": shot.viewmat[None], "K": shot.K[None]}
    with torch.no_grad():
        (seen,), (alpha,), _ = rasterize(*given.values(), render_mode=_OPTIONS.render_mode)
    return seen, alpha[..., 0]


def weigh(shot: Shot) -> Tensor:
    """[n] blend weights of the Gaussians, summed over the pixels: how much of each shows; nothing is differentiated.

    Raises `ValueError` naming what is of another shape, or not finite of what tells where they show.
    """
    library = native.kernels_for(shot.means.device)
    if library is None:
        return weigh_reference(shot)
    workspace, weights = native.Workspace(library), _empty(shot, len(shot.means))
    _do(lambda request: library.weigh(workspace, request, weights.data_ptr()), shot, Options())
    return weights


def weigh_reference(shot: Shot) -> Tensor:
    """The same by `rasterize`, on any device, as the gradient of a feature that is zero everywhere."""
    if not len(shot.means):
        return shot.means.new_zeros(0)
    nothing = shot.means.new_zeros(len(shot.means), 1, requires_grad=True)
    given = {**vars(shot), "rgb": nothing, "viewmat": shot.viewmat[None], "K": shot.K[None]}
    shown, _, _ = rasterize(*given.values())
    (weights,) = torch.autograd.grad(shown.sum(), nothing)
    return weights[:, 0]


def _empty(shot: Shot, *shape: int) -> Tensor:
    """Room for what the library writes, whatever torch makes by default."""
    return shot.means.new_empty(shape, dtype=torch.float32)


def _do(work: Callable[[native.Request], None], shot: Shot, options: Options, **fields: Field) -> None:
    """One call of the compiled library; `fields` are those of the request that a shot does not give."""
    tensors = {name: of for name, of in vars(shot).items() if isinstance(of, Tensor)}
    given = [of.detach().float().contiguous() for of in tensors.values()]
    count = len(shot.means)
    shapes = ((count, 3), (count, 4), (count, 3), (count,), (count, 3), (4, 4), (3, 3))
    for name, of, shape in zip(tensors, given, shapes, strict=True):
        require_layout(name, of, shape, torch.float32)
    radii = shot.means.new_empty(count, 2, dtype=torch.int32)
    means2d, depths = _empty(shot, count, 2), _empty(shot, count)
    request = new_request(
        options,
        batches=1,
        cameras=1,
        gaussians=count,
        width=shot.width,
        height=shot.height,
        threads=thread_count(),
        **dict(zip(_FIELDS, given, strict=True)),
        radii=radii,
        means2d=means2d,
        depths=depths,
        **fields,
    )
    with not_finite_is_named(dict(zip(tensors, given, strict=True))):
        work(request)
