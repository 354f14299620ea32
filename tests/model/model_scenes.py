"""A scene made of known Gaussians, seen by three cameras: a textured table, and a block that slides over it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from twin_node.geometry import looking_at
from twin_node.model.rendering import Splats, render
from twin_node.scene import Camera, FrameSet, JointSample, View

TICK_NS = 33_000_000
BLOCK_SPEED = 0.3
"""m/s along x."""


def camera(
    name: str, eye: Sequence[float], target: Sequence[float] = (0, 0, 0), width: int = 80, height: int = 60
) -> Camera:
    """A camera at `eye` that looks at `target`, 60 degrees wide."""
    focal = width / 2 / np.tan(np.radians(30))
    K = np.array([[focal, 0, width / 2], [0, focal, height / 2], [0, 0, 1]])
    return Camera(name, width, height, K, looking_at(eye, target))


def rig(width: int = 80, height: int = 60) -> tuple[Camera, ...]:
    """Three cameras about a table at z = 0, 40 degrees apart."""
    eyes = [(1.0, -0.5, 0.8), (1.1, 0.2, 0.9), (0.8, 0.8, 0.8)]
    return tuple(camera(f"cam{i}", eye, width=width, height=height) for i, eye in enumerate(eyes))


def table() -> Splats:
    """Gaussians of a table of blotches, 1.6 m square, before a dark room."""
    rng = np.random.default_rng(3)
    x, y = np.meshgrid(np.arange(-0.8, 0.8, 0.04), np.arange(-0.8, 0.8, 0.04))
    means = np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], 1)
    patches = rng.uniform(0.1, 0.9, (10, 10, 3)).repeat(4, 0).repeat(4, 1).reshape(-1, 3)
    flat = _splats(means, patches[: len(means)], 0.022)
    return replace(flat, scales=flat.scales * torch.tensor([1.0, 1.0, 0.1]))


def block(x: float, y: float = 0.0) -> Splats:
    """Gaussians of a mottled block 16 cm wide and 10 cm high that stands at (x, y)."""
    side = np.linspace(-0.08, 0.08, 9)
    grid = np.stack(np.meshgrid(side, side, np.linspace(0.01, 0.1, 6)), -1).reshape(-1, 3)
    mottled = np.random.default_rng(5).uniform(0.4, 1.0, (len(grid), 3))
    return _splats(grid + np.array([x, y, 0.0]), mottled, 0.012)


def frames(index: int, block_x: float | None, cameras: Sequence[Camera], depth: bool = False) -> FrameSet:
    """Set `index` of the scene with the block at `block_x` (None: no block)."""
    return seen(index, table() if block_x is None else joined(table(), block(block_x)), cameras, depth)


def seen(index: int, splats: Splats, cameras: Sequence[Camera], depth: bool = False) -> FrameSet:
    """Set `index` of a scene that is `splats` now."""
    stamp = 1_000_000_000 + index * TICK_NS
    views = []
    with torch.no_grad():
        for one, image in zip(cameras, render(splats, cameras), strict=True):
            rgb = (image.rgb.clamp(0, 1).numpy() * 255).round().astype(np.uint8)
            solid = np.where(image.alpha.numpy() > 0.5, image.depth.numpy(), 0).astype(np.float32)
            views.append(View(one, stamp, rgb, solid if depth else None))
    return FrameSet(stamp, tuple(views), sequence=index)


def with_joints(one: FrameSet, names: tuple[str, ...], positions: np.ndarray) -> FrameSet:
    """The set with joint angles at its stamp."""
    return replace(one, joints=JointSample(one.stamp, names, positions, np.zeros_like(positions)))


def sliding(count: int, cameras: Sequence[Camera], depth: bool = False, still: int = 2) -> list[FrameSet]:
    """Sets of the block standing for `still` sets and then sliding at `BLOCK_SPEED`."""
    step = BLOCK_SPEED * TICK_NS * 1e-9
    return [frames(i, -0.15 + max(0, i - still) * step, cameras, depth) for i in range(count)]


def joined(a: Splats, b: Splats) -> Splats:
    """Both sets of Gaussians."""
    return Splats(
        *(torch.cat([x, y], 1 if x.ndim == 3 else 0) for x, y in zip(vars(a).values(), vars(b).values(), strict=True))
    )


def _splats(means: np.ndarray, rgb: np.ndarray, scale: float) -> Splats:
    count = len(means)
    quats = torch.zeros(1, count, 4)
    quats[..., 0] = 1
    return Splats(
        torch.from_numpy(means).float()[None],
        quats,
        torch.full((count, 3), scale),
        torch.full((count,), 0.97),
        torch.from_numpy(rgb).float(),
    )
