"""How much each of some Gaussians shows to a camera: one call of the compiled library, or the gradient of a feature."""

from __future__ import annotations

import torch
from torch import Tensor

from twin_node.native_library import thread_count
from twin_node.splat import library as native
from twin_node.splat.arguments import Options, non_finite, require_layout
from twin_node.splat.dispatch import rasterize
from twin_node.splat.request import new_request


def weigh(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    viewmat: Tensor,
    K: Tensor,
    width: int,
    height: int,
) -> Tensor:
    """[n] blend weights of n Gaussians, summed over the pixels of a camera.

    `means` [n, 3], `quats` [n, 4], `scales` [n, 3], `opacities` [n], `viewmat` [4, 4] and `K` [3, 3] as `rasterize`
    takes them; nothing is differentiated. Raises `ValueError` naming what is of another shape or not finite.
    """
    library = native.kernels()
    if library is None or means.device.type != "cpu":
        return weigh_reference(means, quats, scales, opacities, viewmat, K, width, height)
    given = [t.detach().float().contiguous() for t in (means, quats, scales, opacities, viewmat, K)]
    count = len(means)
    shapes = ((count, 3), (count, 4), (count, 3), (count,), (4, 4), (3, 3))
    for name, of, shape in zip(_NAMES, given, shapes, strict=True):
        require_layout(name, of, shape, torch.float32)
    weights = torch.empty(count)
    radii, means2d, depths = torch.empty(count, 2, dtype=torch.int32), torch.empty(count, 2), torch.empty(count)
    request = new_request(
        Options(),
        batches=1,
        cameras=1,
        gaussians=count,
        width=width,
        height=height,
        threads=thread_count(),
        **dict(zip(_FIELDS, given, strict=True)),
        radii=radii,
        means2d=means2d,
        depths=depths,
    )
    try:
        library.weigh(native.Workspace(library), request, weights.data_ptr())
    except native.NonFiniteError as error:
        index = error.index if error.index < 4 else error.index - 1  # there are no colours
        raise non_finite(_NAMES[index], given[index]) from None
    return weights


_NAMES = ("means", "quats", "scales", "opacities", "viewmat", "K")
_FIELDS = (*_NAMES[:4], "viewmats", "Ks")


def weigh_reference(
    means: Tensor,
    quats: Tensor,
    scales: Tensor,
    opacities: Tensor,
    viewmat: Tensor,
    K: Tensor,
    width: int,
    height: int,
) -> Tensor:
    """The same by `rasterize`, on any device, as the gradient of a feature that is zero everywhere."""
    if not len(means):
        return means.new_zeros(0)
    nothing = torch.zeros(len(means), 1, device=means.device, requires_grad=True)
    shown, _, _ = rasterize(means, quats, scales, opacities, nothing, viewmat[None], K[None], width, height)
    (weights,) = torch.autograd.grad(shown.sum(), nothing)
    return weights[:, 0]
