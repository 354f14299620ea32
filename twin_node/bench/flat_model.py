"""The plane that a cell's cameras look at as Gaussians, their colours fitted to some of the cameras."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import torch

from twin_node import splat
from twin_node.model.plane import Plane
from twin_node.model.rotations import quat_between
from twin_node.scene import Bool, Camera, Float32, Float64, View

SPREAD = 0.6
"""Radius of a Gaussian (1 sigma) in units of their spacing: together they cover the plane evenly."""
THICKNESS_M = 1e-4
OPACITY = 0.9
RATE = 0.02
"""Adam's rate for colours in 0 to 1, falling to a tenth."""


class FlatModel:
    """Gaussians in a square lattice on a plane; only colours are learnt, so that nothing can hide a rig's errors."""

    def __init__(self, plane: Plane, region: Float64, spacing: float) -> None:
        """`region` [2, 2]: lower and upper corner in x and y, m, of a plane that is not upright; `spacing` in m."""
        x, y = (np.arange(low, high, spacing) for low, high in region.T)
        grid = np.stack(np.meshgrid(x, y, indexing="ij"), axis=-1).reshape(-1, 2)
        z = -(grid @ plane.normal[:2] + plane.offset) / plane.normal[2]
        up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
        quat = quat_between(up, torch.from_numpy(plane.normal)).float()
        self._means = torch.from_numpy(np.column_stack([grid, z])).float()
        self._quats = quat.expand(len(grid), 4)
        self._scales = torch.tensor([SPREAD * spacing] * 2 + [THICKNESS_M], dtype=torch.float32).expand(len(grid), 3)
        self._opacities = torch.full((len(grid),), OPACITY)
        self._colours = torch.full((len(grid), 3), 0.5)

    def fit(self, views: Sequence[View], masks: Sequence[Bool], steps: int) -> None:
        """Fits the colours to the pixels of `masks` [H, W] of views by least squares, with Adam."""
        colours = self._colours.clone().requires_grad_()
        descent = torch.optim.Adam([colours], RATE)
        schedule = torch.optim.lr_scheduler.ExponentialLR(descent, 0.1 ** (1 / steps))
        targets = [torch.from_numpy(view.rgb / np.float32(255)) for view in views]
        shown = [torch.from_numpy(mask) for mask in masks]
        for _ in range(steps):
            descent.zero_grad()
            loss = torch.zeros(())
            for view, target, mask in zip(views, targets, shown, strict=True):
                loss = loss + ((self._draw(view.camera, colours, mask) - target)[mask] ** 2).mean()
            loss.backward()  # type: ignore[no-untyped-call]
            descent.step()
            schedule.step()
        self._colours = colours.detach()

    def render(self, camera: Camera) -> Float32:
        """[H, W, 3] what a camera sees, 0 to 1."""
        with torch.no_grad():
            return np.asarray(self._draw(camera, self._colours, None).numpy(), np.float32)

    def _draw(self, camera: Camera, colours: torch.Tensor, mask: torch.Tensor | None) -> torch.Tensor:
        images, _, _ = splat.rasterize(
            self._means,
            self._quats,
            self._scales,
            self._opacities,
            colours,
            torch.from_numpy(camera.viewmat).float()[None],
            torch.from_numpy(camera.K).float()[None],
            camera.width,
            camera.height,
            pixel_mask=None if mask is None else mask[None],
        )
        return images[0]
