"""A log as tables: obstacle tracks and arm poses as CSV, Gaussians over time as NumPy arrays."""

from __future__ import annotations

import csv
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from twin_node.geometry import quat_from_rotation
from twin_node.nodes.export.moments import ExportError, Moment
from twin_node.robot import ArmModel, forward_kinematics
from twin_node.scene import ObstacleKind, ObstacleShape

OBSTACLE_COLUMNS = (
    *("stamp_ns", "seconds", "id", "kind", "shape", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"),
    *("size_x_m", "size_y_m", "size_z_m", "vx_m_s", "vy_m_s", "vz_m_s", "bound_m"),
)


def write_obstacle_table(moments: Sequence[Moment], path: Path) -> None:
    """One row per obstacle in force at each moment."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        writer.writerow(OBSTACLE_COLUMNS)
        for moment in moments:
            o = moment.obstacles
            for row in range(len(o.ids)):
                writer.writerow(
                    [
                        moment.stamp,
                        f"{moment.seconds:.6f}",
                        o.ids[row],
                        ObstacleKind(int(o.kinds[row])).name,
                        ObstacleShape(int(o.shapes[row])).name,
                        *(f"{v:.9g}" for v in (*o.positions[row], *o.quats[row], *o.sizes[row], *o.velocities[row])),
                        f"{o.bounds[row]:.9g}",
                    ]
                )


def write_arm_table(moments: Sequence[Moment], arm: ArmModel, path: Path) -> None:
    """One row per moment: joint angles, and the pose of the last link in `base_link`."""
    with path.open("w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file)
        joints = [f"{name}_rad" for name in arm.joint_names]
        writer.writerow(["stamp_ns", "seconds", *joints, "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"])
        for moment in moments:
            if moment.q is not None:
                tool = forward_kinematics(arm, moment.q)[-1]
                values = (*moment.q, *tool[:3, 3], *quat_from_rotation(tool[:3, :3]))
                writer.writerow([moment.stamp, f"{moment.seconds:.6f}", *(f"{v:.9g}" for v in values)])


def write_arrays(moments: Sequence[Moment], path: Path) -> None:
    """All Gaussians of all moments, one after another: moment k has rows `starts[k]` to `starts[k + 1]`.

    Arrays: `stamps` [T] ns, `starts` [T + 1], and the fields of `scene.GaussianCloud`, [N, ...].
    Raises `ExportError` where a moment has no Gaussians.
    """
    clouds = [moment.cloud for moment in moments if moment.cloud is not None]
    if len(clouds) < len(moments):
        raise ExportError("npz: expected Gaussians at every time, found none at some; choose a later --start")
    columns: dict[str, Any] = {
        name: np.concatenate([getattr(cloud, name) for cloud in clouds]) for name in vars(clouds[0]) if name != "nodes"
    }
    starts = np.cumsum([0, *(len(cloud.means) for cloud in clouds)])
    with path.open("wb") as file:
        np.savez_compressed(file, stamps=np.array([m.stamp for m in moments]), starts=starts, **columns)
