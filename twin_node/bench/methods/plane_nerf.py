"""A dynamic NeRF: density and colour from planes over space and time, volume-rendered (HexPlane, CVPR 2023)."""

from __future__ import annotations

import functools
from collections.abc import Sequence
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
from twin_node.nodes.report.quality import valid_pixels
from twin_node.scene import Camera, Float32, View

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
    cameras = [
        CameraPixels([view for view in recording.train if view.camera.name == camera.name], span)
        for camera in recording.cameras
    ]
    groups = [{"params": list(nerf.planes.parameters())}, {"params": list(nerf.decoder.parameters())}]
    optimizer = torch.optim.Adam(groups, fused=True)
    for step in range(sizes.steps):
        for group, rate in zip(optimizer.param_groups, (GRID_RATE, DECODER_RATE), strict=True):
            group["lr"] = rate * FINAL_SHARE ** (step / sizes.steps)
        sample = _draw(cameras, sizes.rays, random)
        depths = _depths(shell, sizes.samples, len(sample.rgb), random)
        error = (nerf.shade(sample.rays, depths) - sample.rgb).square().mean()
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


@dataclass(frozen=True)
class Sample:
    """Rays and what the images show at their ends."""

    rays: Rays
    rgb: Tensor
    """[R, 3] 0 to 1."""

    def joined(self, other: Sample) -> Sample:
        """Both."""
        rays = (torch.cat(pair) for pair in zip(vars(self.rays).values(), vars(other.rays).values(), strict=True))
        return Sample(Rays(*rays), torch.cat([self.rgb, other.rgb]))


class CameraPixels:
    """All pixels of one camera that stands still."""

    def __init__(self, views: Sequence[View], span: Span) -> None:
        """`views`: the camera's, in rising order of stamps."""
        images = np.stack([view.rgb for view in views])
        self._rays = _camera_rays(views[0].camera, 0.0)
        self._times = span.times([view.stamp for view in views])
        self._rgb = torch.from_numpy(images).view(len(views), -1, 3)
        changed = np.abs(images - np.median(images, axis=0)).max(-1) > 255 * MOVING
        valid = np.stack([valid_pixels(view) for view in views])
        self._valid, self._moving = (torch.from_numpy(np.flatnonzero(of)) for of in (valid, changed & valid))

    def draw(self, count: int, random: torch.Generator) -> Sample:
        """`count` valid pixels: half of all, half of the moving ones where there are any."""
        pixels = self._rgb.shape[1]
        chosen = self._valid[torch.randint(len(self._valid), (count,), generator=random)]
        if len(self._moving):
            some = torch.randint(len(self._moving), (count // 2,), generator=random)
            chosen[: count // 2] = self._moving[some]
        image, pixel = chosen // pixels, chosen % pixels
        rays = Rays(self._rays.origins[pixel], self._rays.directions[pixel], self._times[image])
        return Sample(rays, self._rgb[image, pixel].float() / 255)


def _draw(cameras: Sequence[CameraPixels], count: int, random: torch.Generator) -> Sample:
    """At least `count` pixels, as many of every camera."""
    share = -(-count // len(cameras))
    return functools.reduce(Sample.joined, (camera.draw(share, random) for camera in cameras))


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
