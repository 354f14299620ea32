"""From Gaussians in `base_link`, each view's at its own time, to what a camera sees of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property, lru_cache

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor

from twin_node import splat
from twin_node.model.kernel_requests import BackdropRequest
from twin_node.model.kernels import kernels_for
from twin_node.model.transfers import on_host, sent
from twin_node.scene import Bool, Camera, Float32


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


def shot_of(splats: Splats, camera: Camera) -> splat.Shot:
    """`splats`, all at one time, before a camera."""
    viewmat, K = (torch.from_numpy(of).to(splats.means.device, torch.float32) for of in (camera.viewmat, camera.K))
    gaussians = (splats.means[0], splats.quats[0], splats.scales, splats.opacities, splats.rgb)
    return splat.Shot(*gaussians, viewmat, K, camera.width, camera.height)


@dataclass(frozen=True)
class Rendering:
    """What one camera sees."""

    rgbd: Tensor
    """[H, W, 4] colour 0 to 1 on black, and expected depth along the optical axis, m; 0 where nothing is."""
    alpha: Tensor
    """[H, W] 0 to 1."""

    @cached_property
    def pixels(self) -> Float32:
        """[H, W, 4] `rgbd` for NumPy, which several ask for; not to be written to."""
        return on_host(self.rgbd)

    def colours_at(self, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> Float32:
        """[n, 3] of some pixels [n] alone."""
        flat = torch.from_numpy(rows * self.rgbd.shape[1] + columns).to(self.rgbd.device)
        return on_host(self.rgbd.reshape(-1, 4).index_select(0, flat)[:, :3])

    @property
    def rgb(self) -> Tensor:
        """[H, W, 3]."""
        return self.rgbd[..., :3]

    @property
    def depth(self) -> Tensor:
        """[H, W] m."""
        return self.rgbd[..., 3]


@dataclass(frozen=True)
class Shots:
    """Cameras of one size, as they are rasterised together."""

    viewmats: Tensor
    """[C, 4, 4]."""
    Ks: Tensor
    """[C, 3, 3] pixels."""
    width: int
    height: int
    masks: Tensor | None
    """[C, H, W] pixels that are drawn; None: all."""
    backdrop: Tensor | None
    """[C, H, W, 4] what stands behind all that is drawn, see `render`; None: black."""


@dataclass(frozen=True)
class Sheet:
    """What cameras of one size see, rasterised together."""

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
    seen: dict[int, Rendering] = {}
    for chosen in by_size(cameras):
        of_size = [cameras[i] for i in chosen]
        mask = None if masks is None else [masks[i] for i in chosen]
        behind = None if backdrops is None else [backdrops[i] for i in chosen]
        sheet = shoot(_at(splats, chosen), shots_of(of_size, mask, behind, splats.means.device))
        seen |= {index: Rendering(sheet.rgbd[i], sheet.alpha[i]) for i, index in enumerate(chosen)}
    return [seen[index] for index in range(len(cameras))]


def shots_of(
    cameras: Sequence[Camera], masks: Sequence[Bool] | None, backdrops: Sequence[Tensor] | None, device: torch.device
) -> Shots:
    """What is drawn by cameras of one size inside `masks`, which may be smaller, before `backdrops` [H, W, 4] each."""
    height, width = cameras[0].height, cameras[0].width
    viewmats, Ks = (np.stack(of) for of in zip(*((one.viewmat, one.K) for one in cameras), strict=True))
    return Shots(
        torch.from_numpy(viewmats).to(device, torch.float32),
        torch.from_numpy(Ks).to(device, torch.float32),
        width,
        height,
        None if masks is None else sent(masks, (height, width), device),
        None if backdrops is None else _stacked(tuple(backdrops)),
    )


@lru_cache(maxsize=2)
def _stacked(backdrops: tuple[Tensor, ...]) -> Tensor:
    """[C, H, W, 4] of C times [H, W, 4], which nobody writes to; a set asks for the same again and again."""
    return torch.stack(backdrops)


def by_size(cameras: Sequence[Camera]) -> list[list[int]]:
    """Indices of the cameras of each size of image."""
    sizes = [(camera.width, camera.height) for camera in cameras]
    return [[i for i, own in enumerate(sizes) if own == size] for size in dict.fromkeys(sizes)]


def _at(splats: Splats, times: list[int]) -> Splats:
    """At some of the times only, which may be one for all."""
    if splats.means.shape[0] in (1, len(times)):
        return splats
    return replace(splats, means=splats.means[times], quats=splats.quats[times])


def shoot(splats: Splats, shots: Shots) -> Sheet:
    """What the cameras see of `splats`, whose times T are theirs in order (T = 1: one time for all)."""
    if splats.means.shape[1] == 0:
        nothing = splats.means.new_zeros(len(shots.Ks), shots.height, shots.width, 4)
        return Sheet(nothing if shots.backdrop is None else shots.backdrop, nothing[..., 0])
    means, quats = splats.means, splats.quats
    if means.shape[0] == 1:
        means, quats = means[0], quats[0]
    renders, alphas, _ = splat.rasterize(
        means,
        quats,
        splats.scales,
        splats.opacities,
        splats.rgb,
        shots.viewmats[:, None],
        shots.Ks[:, None],
        shots.width,
        shots.height,
        render_mode="RGB+ED" if shots.backdrop is None else "RGB+D",
        pixel_mask=None if shots.masks is None else shots.masks[:, None],
    )
    seen = renders[:, 0] if shots.backdrop is None else put_before(renders[:, 0], alphas[:, 0], shots.backdrop)
    return Sheet(seen, alphas[:, 0, ..., 0])


def put_before(renders: Tensor, alphas: Tensor, backdrop: Tensor) -> Tensor:
    """[C, H, W, 4] `renders` with `alphas` [C, H, W, 1], drawn on nothing, before a `backdrop`; they are used up."""
    library = kernels_for(renders.device)
    if library is None or renders.requires_grad:
        return put_before_reference(renders, alphas, backdrop)
    held = (alphas.contiguous(), backdrop.contiguous(), renders)
    library.run(BackdropRequest(alphas.numel(), *(t.data_ptr() for t in held)))
    return renders


def put_before_reference(renders: Tensor, alphas: Tensor, backdrop: Tensor) -> Tensor:
    """The same in torch, on any device and with gradients: the reference of the compiled kernel."""
    return renders + (1 - alphas) * backdrop
