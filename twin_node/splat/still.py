"""One image of Gaussians, by one call of the compiled library: what `rasterize` draws, with little around it."""

from __future__ import annotations

import torch
from torch import Tensor

from twin_node.native_library import thread_count
from twin_node.splat import library as native
from twin_node.splat.arguments import Options, non_finite
from twin_node.splat.cpu import DEPTH_MODES
from twin_node.splat.dispatch import rasterize
from twin_node.splat.semantics import installed_semantics

_OPTIONS = Options(render_mode="RGB+ED")
_NAMES = ("means", "quats", "scales", "opacities", "rgb", "viewmat", "K")


def draw_still(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    rgb: Tensor,
    viewmat: Tensor,
    K: Tensor,
    width: int,
    height: int,
) -> tuple[Tensor, Tensor]:
    """What one camera sees of n Gaussians; nothing is differentiated.

    `means` [n, 3], `quats` [n, 4], `scales` [n, 3], `opacities` [n], `rgb` [n, 3], `viewmat` [4, 4] and `K` [3, 3] as
    `rasterize` takes them. Gives colour (0 to 1, on black) and expected depth along the optical axis [H, W, 4], 0 where
    nothing is, and alpha [H, W]. Raises `ValueError` naming what is not finite.
    """
    library = native.native_library()
    if library is None or means.device.type != "cpu":
        return draw_still_plainly(means, quats, scales, opacities, rgb, viewmat, K, width, height)
    given = [t.detach().float().contiguous() for t in (means, quats, scales, opacities, rgb, viewmat, K)]
    count, semantics = len(means), installed_semantics()
    rgbd, alpha = torch.empty(height, width, 4), torch.empty(height, width)
    found = (torch.empty(count, 2, dtype=torch.int32), torch.empty(count, 2), torch.empty(count))
    request = native.Request(
        *(1, 1, count, width, height, 3),
        *(0, 0, 0, DEPTH_MODES[_OPTIONS.render_mode], 0, thread_count()),
        *_OPTIONS.limits,
        semantics.max_alpha,
        semantics.min_compensation,
        *(0, 0, 0, 0, 0),
        *(t.data_ptr() for t in given),
        *(None, None, None, None),
        *(t.data_ptr() for t in (rgbd, alpha, *found)),
    )
    try:
        library.forward(native.Workspace(library), request)
    except native.NonFiniteError as error:
        raise non_finite(_NAMES[error.index], given[error.index]) from None
    return rgbd, alpha


def draw_still_plainly(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    rgb: Tensor,
    viewmat: Tensor,
    K: Tensor,
    width: int,
    height: int,
) -> tuple[Tensor, Tensor]:
    """The same by `rasterize`, on any device: the reference of `draw_still`."""
    if not len(means):
        return means.new_zeros(height, width, 4), means.new_zeros(height, width)
    with torch.no_grad():
        (seen,), (alpha,), _ = rasterize(
            means,
            quats,
            scales,
            opacities,
            rgb,
            viewmat[None],
            K[None],
            width,
            height,
            render_mode=_OPTIONS.render_mode,
        )
    return seen, alpha[..., 0]
