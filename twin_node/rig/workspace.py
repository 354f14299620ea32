"""Derives the volume to model from what the cameras see together."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin_node.geometry import project
from twin_node.rig.errors import RigError
from twin_node.scene import Bool, Camera, Float64

FLOOR_M = -0.05
"""Lower end of a derived volume where all cameras stand above the base: the arm stands on what they look at (z = 0)."""

FARTHEST_M = 5.0
"""Where a camera looks at the base's plane tells where its work is only this near to it."""

RANGE = (0.15, 1.25)
"""Depths that count as seen, as shares of a camera's distance to the point that all look at: not lens or far wall."""

TRIMMED_PERCENT = 0.5
"""Share of the seen cells cut off at each face, so that the box does not grow with the thin tips of the seen region."""

CELLS = 64
"""Cells per axis that are looked at: a box is then exact to 2 % of the rig's size."""

MIN_AXES_SPREAD = 0.003
"""Mean squared sine of the angles between optical axes and their mean (3 degrees); below it they may not meet."""

_GIVE_IT = "give a rig file (--rig RIG.yaml) with `workspace: {min, max}`"


def workspace_of(cameras: Sequence[Camera]) -> Float64:
    """The box [2, 3] (lower and upper corner, metres, `base_link`) about what most of the cameras see together.

    It lies about the point that all look at; of one camera, or parallel ones, about where they look at the plane that
    the arm stands on. Raises `RigError` where these do not look down at it, or cameras see nothing together.
    """
    poses = np.stack([camera.T_base_cam for camera in cameras])
    focus = axes_focus(poses) if axes_spread(poses) >= MIN_AXES_SPREAD else _focus_on_plane(cameras, poses)
    distances = np.linalg.norm(poses[:, :3, 3] - focus, axis=1)
    reach = distances.mean() * RANGE[1]
    lower, upper = focus - reach, focus + reach
    if (poses[:, 2, 3] > 0).all():
        lower[2] = max(lower[2], FLOOR_M)
    cells = _cells(lower, upper)
    seen_by = sum(_sees(c, cells, d).astype(np.int64) for c, d in zip(cameras, distances, strict=True))
    seen = cells[seen_by > len(cameras) // 2]
    if not len(seen):
        raise RigError(
            f"cameras: expected a volume that most of them see, found none; check `T_base_cam`, or {_GIVE_IT}"
        )
    half_cell = (upper - lower) / (2 * CELLS)
    box = np.percentile(seen, [TRIMMED_PERCENT, 100 - TRIMMED_PERCENT], axis=0)
    return np.asarray(box + np.stack([-half_cell, half_cell]))


def _focus_on_plane(cameras: Sequence[Camera], poses: Float64) -> Float64:
    """Mean point [3] at which cameras' axes meet z = 0, m. Raises `RigError` where one does not, or only far away."""
    heights, slopes = poses[:, 2, 3], poses[:, 2, 2]
    away = heights / np.maximum(-slopes, 1e-9)  # upward, or along it: beyond all that is near
    if not ((away > 0) & (away <= FARTHEST_M)).all():
        names = ", ".join(camera.name for camera in cameras)
        found = "this one alone" if len(cameras) == 1 else "parallel ones"
        raise RigError(
            f"camera {names}: expected views from different sides to derive the workspace from, or of the plane that "
            f"the arm stands on within {FARTHEST_M:g} m, found {found}; {_GIVE_IT}"
        )
    return np.asarray((poses[:, :3, 3] + away[:, None] * poses[:, :3, 2]).mean(0))


def axes_focus(poses: Float64) -> Float64:
    """Point [3] nearest to the optical axes of cameras with poses `T_base_cam` [N, 4, 4] (least squares), metres."""
    axes, centres = poses[:, :3, 2], poses[:, :3, 3]
    across = np.eye(3) - axes[:, :, None] * axes[:, None, :]
    nearest, *_ = np.linalg.lstsq(across.sum(0), np.einsum("nij,nj->i", across, centres), rcond=None)
    return np.asarray(nearest, dtype=np.float64)


def axes_spread(poses: Float64) -> float:
    """Mean squared sine of the angles between the optical axes of poses [N, 4, 4] and their mean line; 0: parallel."""
    axes = poses[:, :3, 2]
    return 1 - float(np.linalg.eigvalsh(axes.T @ axes)[-1]) / len(axes)


def _cells(lower: Float64, upper: Float64) -> Float64:
    """Centres [CELLS^3, 3] of a regular grid between two corners."""
    steps = (np.arange(CELLS) + 0.5) / CELLS
    x, y, z = (low + steps * (high - low) for low, high in zip(lower, upper, strict=True))
    return np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1).reshape(-1, 3)


def _sees(camera: Camera, points: Float64, distance: float) -> Bool:
    """Which points [N, 3] lie in a camera's image and within `RANGE` times `distance` metres."""
    u, v, z = project(camera.K, camera.viewmat, points).T
    in_range = (z > RANGE[0] * distance) & (z < RANGE[1] * distance)
    in_image = (u > 0) & (u < camera.width) & (v > 0) & (v < camera.height)
    return np.asarray(in_range & in_image)
