"""A dynamic NeRF: density and colour from planes over space and time, volume-rendered (HexPlane, CVPR 2023)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor, nn

from twin_node.bench.methods.following import no_motion
from twin_node.bench.methods.protocol import Budget, Fitted, NerfParameters, Progress
from twin_node.model.rays import pixel_rays
from twin_node.model.sequence import Box, Recording, Span
from twin_node.model.sequence.field import linear
from twin_node.model.sequence.hex_plane import Planes
from twin_node.model.sweep import Shell, shell_around
from twin_node.scene import Camera, Float32

NEAR, FAR = 0.25, 2.5
"""Where rays begin and end, in units of the cameras' distance from what they look at; what is farther is at the end."""
BOX_REACH = 1.5
"""Half side of the planes' box, in the same units; beyond, they are clamped."""
GRID_RATE, DECODER_RATE = 2e-2, 2e-3
FINAL_SHARE = 0.1
"""Of the rates, at the end of an exponential decay (HexPlane, section 4)."""
MOVING = 0.1
"""Channel difference (0 to 1) from the camera's median image that makes a pixel a moving one."""
ROWS_AT_ONCE = 4096
"""Rays drawn at once when an image is rendered."""


class PlaneNerf(nn.Module):
    """Density and colour at points and times."""

    def __init__(self, box: Box, columns: int, sizes: NerfParameters, random: torch.Generator) -> None:
        super().__init__()
        self.box = box
        self.planes = Planes(sizes.resolution, columns, sizes.features, (1, 2), random)
        hidden, out = linear(self.planes.width, sizes.hidden, random), linear(sizes.hidden, 4, random)
        self.decoder = nn.Sequential(hidden, nn.ReLU(), out)

    def shade(self, rays: Rays, depths: Tensor) -> Tensor:
        """[R, 3] colours of rays sampled at depths [R, S] (m along the ray); the last sample stands for all beyond."""
        points = rays.origins[:, None] + depths[..., None] * rays.directions[:, None]
        times = rays.times[:, None].expand_as(depths)
        features = self.planes(self.box.unit(points.reshape(-1, 3)), times.reshape(1, -1))[0]
        out = self.decoder(features).view(*depths.shape, 4)
        density = nn.functional.softplus(out[..., 3] - 1) / self.box.reach * 10
        steps = torch.cat([depths.diff(dim=1), depths.new_full((len(depths), 1), 1e6)], 1)
        alpha = 1 - torch.exp(-density * steps)
        through = torch.cumprod(torch.cat([torch.ones_like(alpha[:, :1]), 1 - alpha[:, :-1]], 1), 1)
        colour: Tensor = ((alpha * through)[..., None] * out[..., :3].sigmoid()).sum(1)
        return colour


@dataclass(frozen=True)
class Rays:
    """Rays of pixels."""

    origins: Tensor
    """[R, 3] m."""
    directions: Tensor
    """[R, 3] of length 1."""
    times: Tensor
    """[R] -1 to 1 over the sequence."""

    def chosen(self, rows: Tensor) -> Rays:
        """Those of `rows`."""
        return Rays(self.origins[rows], self.directions[rows], self.times[rows])


def fit_nerf(recording: Recording, budget: Budget, progress: Progress) -> Fitted:
    """Learns from random rays, half of them where something moves (Neural 3D Video, section 3.3)."""
    sizes = budget.nerf
    random = torch.Generator().manual_seed(budget.seed)
    shell = shell_around(recording.cameras, 1.0)
    box = _box(shell)
    nerf = PlaneNerf(box, max((recording.steps + 1) // 2, 2), sizes, random)
    span = Span(recording.first, recording.last)
    data = _Pixels(recording, span)
    groups = [{"params": list(nerf.planes.parameters())}, {"params": list(nerf.decoder.parameters())}]
    optimizer = torch.optim.Adam(groups, fused=True)
    for step in range(sizes.steps):
        for group, rate in zip(optimizer.param_groups, (GRID_RATE, DECODER_RATE), strict=True):
            group["lr"] = rate * FINAL_SHARE ** (step / sizes.steps)
        rows = data.draw(sizes.rays, random)
        depths = _depths(shell, sizes.samples, len(rows), random)
        error = (nerf.shade(data.rays.chosen(rows), depths) - data.rgb[rows]).square().mean()
        planes = nerf.planes
        loss = error + 1e-3 * planes.variation() + 1e-2 * planes.bend() + 1e-4 * planes.change()
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        optimizer.step()
        progress((step + 1) / sizes.steps)

    def render(camera: Camera, stamp: int) -> Float32:
        return _render(nerf, shell, sizes.samples, camera, float(span.times([stamp])[0]))

    count = sum(parameter.numel() for parameter in nerf.parameters())
    return Fitted(render, no_motion, count, 4 * count)


class _Pixels:
    """All pixels of a recording as rays and colours."""

    def __init__(self, recording: Recording, span: Span) -> None:
        views = recording.train
        per_camera: dict[str, Rays] = {}
        rays, moving = [], []
        medians = {
            camera.name: np.median([v.rgb for v in views if v.camera.name == camera.name], axis=0)
            for camera in recording.cameras
        }
        for view in views:
            name = view.camera.name
            if name not in per_camera:
                per_camera[name] = _camera_rays(view.camera, 0.0)
            own = per_camera[name]
            rays.append(Rays(own.origins, own.directions, span.times([view.stamp]).expand(len(own.origins))))
            moving.append((np.abs(view.rgb - medians[name]).max(-1) > 255 * MOVING).ravel())
        self.rays = Rays(*(torch.cat([getattr(r, name) for r in rays]) for name in vars(rays[0])))
        self.rgb = torch.cat([torch.from_numpy(view.rgb).reshape(-1, 3) for view in views]).float() / 255
        self._moving = torch.from_numpy(np.flatnonzero(np.concatenate(moving)))

    def draw(self, count: int, random: torch.Generator) -> Tensor:
        """[count] rows: half of all pixels, half of the moving ones."""
        anywhere = torch.randint(len(self.rgb), (count - count // 2,), generator=random)
        if not len(self._moving):
            return anywhere
        return torch.cat([anywhere, self._moving[torch.randint(len(self._moving), (count // 2,), generator=random)]])


def _camera_rays(camera: Camera, time: float) -> Rays:
    directions = torch.from_numpy(pixel_rays(camera).reshape(-1, 3)).float()
    origin = torch.from_numpy(camera.T_base_cam[:3, 3]).float()
    unit = nn.functional.normalize(directions, dim=-1)
    return Rays(origin.expand(len(unit), 3), unit, torch.full((len(unit),), time))


def _box(shell: Shell) -> Box:
    centre = torch.tensor(shell.centre, dtype=torch.float32)
    return Box(centre - BOX_REACH * shell.radius, centre + BOX_REACH * shell.radius)


def _depths(shell: Shell, samples: int, rays: int, random: torch.Generator | None) -> Tensor:
    """[R, S] depths, m: one in each of equal parts of the ray; at its middle without `random`."""
    part = torch.full((rays, samples), 0.5) if random is None else torch.rand(rays, samples, generator=random)
    return shell.radius * (NEAR + (FAR - NEAR) * (torch.arange(samples) + part) / samples)


def _render(nerf: PlaneNerf, shell: Shell, samples: int, camera: Camera, time: float) -> Float32:
    rays = _camera_rays(camera, time)
    parts = []
    with torch.no_grad():
        for begin in range(0, len(rays.times), ROWS_AT_ONCE):
            some = rays.chosen(torch.arange(begin, min(begin + ROWS_AT_ONCE, len(rays.times))))
            parts.append(nerf.shade(some, _depths(shell, samples, len(some.times), None)))
    image: Float32 = torch.cat(parts).view(camera.height, camera.width, 3).clamp(0, 1).numpy()
    return image
