"""The first set of images as Gaussians: measured or swept depth, back-projected, one Gaussian per block of pixels."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
import torch
from torch import Tensor

from twin_node.model.balance import balance
from twin_node.model.exposure import levelled
from twin_node.model.features import triangulate
from twin_node.model.gaussians import Newborns
from twin_node.model.parameters import SeedParameters
from twin_node.model.plane import Plane, dominant_plane, plane_through
from twin_node.model.rays import back_project
from twin_node.model.rotations import quat_between
from twin_node.model.sweep import Surface, shell_around, sweep
from twin_node.scene import Exposure, Float32, Float64, Tier, View

PLANE_SAMPLES = 4000
"""Measured points that the dominant plane is fitted to."""
FLATNESS = 0.2
"""Thickness of a Gaussian on the dominant plane in units of its radius."""
SEED_OPACITY = 0.5
SEED_SIGMA = 1.5
"""Of a Gaussian, in radii of the block that it stands for: neighbours overlap, so that other views see no gaps."""
CELL = 1.4
"""Side of the cells in which blocks of several views are merged, in radii of a block, which is two wide: what two views
show of one place they show of different halves of it."""


@dataclass(frozen=True)
class Seeds:
    """What a scene starts from."""

    born: Newborns
    plane: Plane | None
    """The dominant plane, where the views agree on one."""
    exposures: tuple[Exposure, ...]
    """Of the views, beside what was made of them."""


def seed(
    views: Sequence[View],
    arms: Sequence[Float32 | None],
    parameters: SeedParameters,
    capacity: int,
    device: torch.device,
) -> Seeds:
    """STATIC Gaussians, at most `capacity`, that explain every pixel of `views`.

    `arms` holds per view the depth [H, W] of the arm in m where its joints tell it (0 elsewhere), or None.
    """
    plane = find_plane(views)
    surfaces = find_surfaces(views, plane, parameters)
    exposures = balance(views, surfaces)
    views = [levelled(view, exposure) for view, exposure in zip(views, exposures, strict=True)]
    surfaces = [
        surface if arm is None or view.depth is not None else _measured(arm, surface)
        for view, surface, arm in zip(views, surfaces, arms, strict=True)
    ]
    stride = parameters.stride_px
    while True:
        born = _merged(_lift(views, surfaces, plane, stride))
        if len(born) <= capacity:
            return Seeds(_as_newborns(born, plane, device), plane, exposures)
        stride += 1


def find_plane(views: Sequence[View]) -> Plane | None:
    """The dominant plane: through what is measured, where any view measures depth, else what the images agree on."""
    measured = [back_project(view.camera, view.depth)[view.depth > 0] for view in views if view.depth is not None]
    points = np.concatenate([np.zeros((0, 3)), *measured])
    if not len(points):
        return dominant_plane(views, triangulate(views))
    centres = np.stack([view.camera.T_base_cam[:3, 3] for view in views])
    return plane_through(points[:: max(len(points) // PLANE_SAMPLES, 1)], centres)


def find_surfaces(views: Sequence[View], plane: Plane | None, parameters: SeedParameters) -> list[Surface]:
    """Depth of every pixel: measured where the camera measures it, swept elsewhere."""
    shell = shell_around([view.camera for view in views], parameters.shell_factor)
    ground = plane or Plane(np.array([0.0, 0.0, 1.0]), 0.0)
    if len(views) > 1 and any(view.depth is None for view in views):
        surfaces = sweep(views, ground, shell, parameters.levels)
    else:
        surfaces = []
        for view in views:
            far, hit = shell.depth(view.camera), ground.depth(view.camera)
            on_plane = (hit > 0.05) & (hit < far)
            surfaces.append(Surface(np.where(on_plane, hit, far), on_plane))
    return [
        surface if view.depth is None else _measured(view.depth, surface)
        for view, surface in zip(views, surfaces, strict=True)
    ]


def _measured(depth: np.ndarray, fallback: Surface) -> Surface:
    known = depth > 0
    return Surface(np.where(known, depth, fallback.depth), fallback.on_plane & ~known)


@dataclass(frozen=True)
class _Blocks:
    """Blocks of pixels in space."""

    means: Float64
    radii: Float64
    rgb: Float64
    flat: np.ndarray

    def __len__(self) -> int:
        return len(self.means)


def _lift(views: Sequence[View], surfaces: Sequence[Surface], plane: Plane | None, stride: int) -> _Blocks:
    parts: list[_Blocks] = []
    for view, surface in zip(views, surfaces, strict=True):
        camera = view.camera
        rows, columns = np.arange(stride // 2, camera.height, stride), np.arange(stride // 2, camera.width, stride)
        grid = np.ix_(rows, columns)
        points = back_project(camera, surface.depth)[grid]
        size = (camera.width // stride + 1, camera.height // stride + 1)
        padded = cv2.copyMakeBorder(view.rgb, 0, stride, 0, stride, cv2.BORDER_REPLICATE)
        padded = padded[: size[1] * stride, : size[0] * stride]
        rgb = cv2.resize(padded, size, interpolation=cv2.INTER_AREA)[: len(rows), : len(columns)] / 255
        radii = 0.5 * stride * surface.depth[grid] / camera.K[0, 0]
        flat = surface.on_plane[grid] & (plane is not None)
        known = np.ones(flat.shape, bool) if view.valid is None else view.valid[grid]
        parts.append(_Blocks(points[known], radii[known], rgb[known], flat[known]))
    return _Blocks(
        np.concatenate([part.means for part in parts]),
        np.concatenate([part.radii for part in parts]),
        np.concatenate([part.rgb for part in parts]),
        np.concatenate([part.flat for part in parts]),
    )


def _merged(blocks: _Blocks) -> _Blocks:
    """One block per cell of its own size: the finest where several views show the same place."""
    order = np.argsort(blocks.radii, kind="stable")
    level = np.round(np.log2(blocks.radii[order]))
    cell = np.floor(blocks.means[order] / (CELL * np.exp2(level))[:, None])
    _, first = np.unique(np.column_stack([level, cell]), axis=0, return_index=True)
    kept = order[np.sort(first)]
    return _Blocks(blocks.means[kept], blocks.radii[kept], blocks.rgb[kept], blocks.flat[kept])


def _as_newborns(blocks: _Blocks, plane: Plane | None, device: torch.device) -> Newborns:
    flat = torch.from_numpy(blocks.flat)
    scales = SEED_SIGMA * torch.from_numpy(blocks.radii)[:, None].repeat(1, 3)
    scales[:, 2] *= torch.where(flat, FLATNESS, 1.0)
    up = torch.tensor([0.0, 0.0, 1.0], dtype=torch.float64)
    normal = up if plane is None else torch.from_numpy(plane.normal)
    quats = torch.where(flat[:, None], quat_between(up, normal), torch.tensor([1.0, 0, 0, 0], dtype=torch.float64))

    def moved(values: Tensor) -> Tensor:
        return values.to(device, torch.float32)

    n = len(blocks)
    return Newborns(
        moved(torch.from_numpy(blocks.means)),
        moved(quats),
        moved(scales),
        torch.full((n,), SEED_OPACITY, device=device),
        moved(torch.from_numpy(blocks.rgb)),
        Tier.STATIC,
        torch.full((n,), -1, dtype=torch.int64, device=device),
    )
