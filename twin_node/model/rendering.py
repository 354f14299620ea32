"""From Gaussians in `base_link`, each view's at its own time, to what a camera sees of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from twin_node import splat
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

    rgb: Tensor
    """[H, W, 3] 0 to 1 on black."""
    depth: Tensor
    """[H, W] expected depth along the optical axis, m; 0 where nothing is."""
    alpha: Tensor
    """[H, W] 0 to 1."""


def join(a: Splats, b: Splats) -> Splats:
    """Both sets of Gaussians, those of `a` first."""
    return Splats(
        torch.cat([a.means, b.means], 1),
        torch.cat([a.quats, b.quats], 1),
        torch.cat([a.scales, b.scales]),
        torch.cat([a.opacities, b.opacities]),
        torch.cat([a.rgb, b.rgb]),
    )


def render(splats: Splats, cameras: Sequence[Camera], masks: Sequence[Bool] | None = None) -> list[Rendering]:
    """What each camera sees of `splats`, whose times T are the cameras in order (T = 1: one time for all).

    Cameras of one size are rasterised together. Pixels outside `masks` (each [H, W]) cost nothing and are black.
    """
    out: list[Rendering | None] = [None] * len(cameras)
    for size in dict.fromkeys((camera.width, camera.height) for camera in cameras):
        chosen = [i for i, camera in enumerate(cameras) if (camera.width, camera.height) == size]
        part = _rasterise(splats, [cameras[i] for i in chosen], chosen, [masks[i] for i in chosen] if masks else None)
        for index, rendering in zip(chosen, part, strict=True):
            out[index] = rendering
    return [rendering for rendering in out if rendering is not None]


def _rasterise(splats: Splats, cameras: list[Camera], times: list[int], masks: list[Bool] | None) -> list[Rendering]:
    device, count = splats.means.device, len(cameras)
    if splats.means.shape[1] == 0:
        nothing = splats.means.new_zeros(cameras[0].height, cameras[0].width)
        return [Rendering(nothing[..., None].repeat(1, 1, 3), nothing, nothing) for _ in cameras]
    viewmats = torch.from_numpy(np.stack([camera.viewmat for camera in cameras])).to(device, torch.float32)
    Ks = torch.from_numpy(np.stack([camera.K for camera in cameras])).to(device, torch.float32)
    at = slice(None) if splats.means.shape[0] == 1 or count == splats.means.shape[0] else times
    mask = None if masks is None else torch.from_numpy(np.stack(masks)).to(device)[:, None]
    renders, alphas, _ = splat.rasterize(
        splats.means[at].expand(count, -1, -1),
        splats.quats[at].expand(count, -1, -1),
        splats.scales.expand(count, -1, -1),
        splats.opacities.expand(count, -1),
        splats.rgb.expand(count, -1, -1),
        viewmats[:, None],
        Ks[:, None],
        cameras[0].width,
        cameras[0].height,
        render_mode="RGB+ED",
        pixel_mask=mask,
    )
    return [Rendering(renders[i, 0, ..., :3], renders[i, 0, ..., 3], alphas[i, 0, ..., 0]) for i in range(count)]
