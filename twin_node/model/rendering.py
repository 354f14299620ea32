"""From Gaussians in `base_link`, each view's at its own time, to what a camera sees of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from twin_node import splat
from twin_node.model.kernel_requests import BackdropRequest
from twin_node.model.kernels import kernels
from twin_node.scene import Bool, Camera


@dataclass(frozen=True)
class Splats:
    """Gaussians in `base_link`, once per time T."""

    means: Tensor
    """[T, N, 3] m."""
    quats: Tensor
    """[T, N, 4] w, x, y, z."""
    scales: Tensor
    """[N, 3] m."""
    opacities: Tensor
    """[N] 0 to 1."""
    rgb: Tensor
    """[N, 3] 0 to 1."""


@dataclass(frozen=True)
class Rendering:
    """What one camera sees."""

    rgbd: Tensor
    """[H, W, 4] colour 0 to 1 on black, and expected depth along the optical axis, m; 0 where nothing is."""
    alpha: Tensor
    """[H, W] 0 to 1."""

    @property
    def rgb(self) -> Tensor:
        """[H, W, 3]."""
        return self.rgbd[..., :3]

    @property
    def depth(self) -> Tensor:
        """[H, W] m."""
        return self.rgbd[..., 3]


@dataclass(frozen=True)
class Sheet:
    """Images of cameras of one size, rasterised together."""

    indices: list[int]
    """Which cameras, in order."""
    rgbd: Tensor
    """[C, H, W, 4] colour 0 to 1 on black, and expected depth, m; 0 where nothing is."""
    alpha: Tensor
    """[C, H, W] 0 to 1."""


def join(a: Splats, b: Splats) -> Splats:
    """Both sets of Gaussians, those of `a` first; one of the two may hold one time for all of the other's."""
    times = max(a.means.shape[0], b.means.shape[0])
    return Splats(
        torch.cat([a.means.expand(times, -1, -1), b.means.expand(times, -1, -1)], 1),
        torch.cat([a.quats.expand(times, -1, -1), b.quats.expand(times, -1, -1)], 1),
        torch.cat([a.scales, b.scales]),
        torch.cat([a.opacities, b.opacities]),
        torch.cat([a.rgb, b.rgb]),
    )


def render(
    splats: Splats,
    cameras: Sequence[Camera],
    masks: Sequence[Bool] | None = None,
    backdrops: Sequence[Tensor] | None = None,
) -> list[Rendering]:
    """What each camera sees of `splats`, whose times T are the cameras in order (T = 1: one time for all).

    Cameras of one size are rasterised together. Pixels outside `masks` (each [H, W]) cost nothing. Behind the Gaussians
    is black, or `backdrops` (each [H, W, 4] colour and depth, m), which then count in the depth too.
    """
    return split(draw(splats, cameras, masks, backdrops))


def draw(
    splats: Splats,
    cameras: Sequence[Camera],
    masks: Sequence[Bool] | None = None,
    backdrops: Sequence[Tensor] | None = None,
) -> list[Sheet]:
    """The same as one sheet per size of image."""
    sheets = []
    for chosen in by_size(cameras):
        mask = None if masks is None else [masks[i] for i in chosen]
        behind = None if backdrops is None else stacked(tuple(backdrops[i] for i in chosen))
        sheets.append(_rasterise(splats, [cameras[i] for i in chosen], chosen, mask, behind))
    return sheets


@lru_cache(maxsize=2)
def stacked(backdrops: tuple[Tensor, ...]) -> Tensor:
    """[C, H, W, 4] of C times [H, W, 4], which nobody writes to; a set asks for the same again and again."""
    return torch.stack(backdrops)


def by_size(cameras: Sequence[Camera]) -> list[list[int]]:
    """Indices of the cameras of each size of image."""
    sizes = [(camera.width, camera.height) for camera in cameras]
    return [[i for i, own in enumerate(sizes) if own == size] for size in dict.fromkeys(sizes)]


def split(sheets: Sequence[Sheet]) -> list[Rendering]:
    """One rendering per camera, in order."""
    out = {index: Rendering(sheet.rgbd[i], sheet.alpha[i]) for sheet in sheets for i, index in enumerate(sheet.indices)}
    return [out[index] for index in range(len(out))]


def _rasterise(
    splats: Splats, cameras: list[Camera], times: list[int], masks: list[Bool] | None, backdrop: Tensor | None
) -> Sheet:
    device, count = splats.means.device, len(cameras)
    if splats.means.shape[1] == 0:
        nothing = splats.means.new_zeros(count, cameras[0].height, cameras[0].width, 4)
        return Sheet(times, nothing if backdrop is None else backdrop, nothing[..., 0])
    viewmats = torch.from_numpy(np.stack([camera.viewmat for camera in cameras])).to(device, torch.float32)
    Ks = torch.from_numpy(np.stack([camera.K for camera in cameras])).to(device, torch.float32)
    means, quats = splats.means, splats.quats
    if means.shape[0] == 1:
        means, quats = means[0], quats[0]
    elif means.shape[0] != count:
        means, quats = means[times], quats[times]
    mask = None if masks is None else torch.from_numpy(np.stack(masks)).to(device)[:, None]
    renders, alphas, _ = splat.rasterize(
        means,
        quats,
        splats.scales,
        splats.opacities,
        splats.rgb,
        viewmats[:, None],
        Ks[:, None],
        cameras[0].width,
        cameras[0].height,
        render_mode="RGB+ED" if backdrop is None else "RGB+D",
        pixel_mask=mask,
    )
    seen = renders[:, 0] if backdrop is None else put_before(renders[:, 0], alphas[:, 0], backdrop)
    return Sheet(times, seen, alphas[:, 0, ..., 0])


def put_before(renders: Tensor, alphas: Tensor, backdrop: Tensor) -> Tensor:
    """[C, H, W, 4] `renders` with `alphas` [C, H, W, 1], drawn on nothing, before a `backdrop`; they are used up."""
    library = kernels()
    if library is None or renders.requires_grad or renders.device.type != "cpu":
        return put_before_plainly(renders, alphas, backdrop)
    held = (alphas.contiguous(), backdrop.contiguous(), renders)
    library.put_before(BackdropRequest(alphas.numel(), *(t.data_ptr() for t in held)))
    return renders


def put_before_plainly(renders: Tensor, alphas: Tensor, backdrop: Tensor) -> Tensor:
    """The same in torch, on any device and with gradients: the reference of the compiled kernel."""
    return renders + (1 - alphas) * backdrop
