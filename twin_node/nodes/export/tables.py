"""A log as tables: obstacle tracks and arm poses as CSV."""

from __future__ import annotations

import csv
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from twin_node.geometry import quat_from_rotation
from twin_node.nodes.export.moments import Moment, Moments
from twin_node.robot import ArmModel, forward_kinematics
from twin_node.scene import MotionExpert, ObstacleKind, ObstacleShape

OBSTACLE_COLUMNS = (
    *("stamp_ns", "seconds", "id", "kind", "shape", "x_m", "y_m", "z_m", "qw", "qx", "qy", "qz"),
    *("size_x_m", "size_y_m", "size_z_m", "vx_m_s", "vy_m_s", "vz_m_s", "bound_m", "expert"),
)
POSE_COLUMNS = ("x_m", "y_m", "z_m", "qw", "qx", "qy", "qz")


def write_tables(moments: Moments, path: Path) -> None:
    """A folder with `obstacles.csv`, a row per obstacle in force at each moment, and `arm.csv`.

    The latter has a row per moment at which the joints are known: their angles, and the pose of the last link in
    `base_link`.
    """
    path.mkdir()
    with (
        (path / "obstacles.csv").open("w", newline="", encoding="utf-8") as obstacles,
        (path / "arm.csv").open("w", newline="", encoding="utf-8") as arm,
    ):
        obstacle_rows, arm_rows = csv.writer(obstacles), csv.writer(arm)
        obstacle_rows.writerow(OBSTACLE_COLUMNS)
        joints = [f"{name}_rad" for name in moments.arm.joint_names]
        arm_rows.writerow(["stamp_ns", "seconds", *joints, *POSE_COLUMNS])
        for moment in moments:
            obstacle_rows.writerows(_obstacle_rows(moment))
            if moment.q is not None:
                arm_rows.writerow(_arm_row(moment, moments.arm))


def _obstacle_rows(moment: Moment) -> Iterator[list[Any]]:
    o = moment.obstacles
    for row in range(len(o.ids)):
        numbers = (*o.positions[row], *o.quats[row], *o.sizes[row], *o.velocities[row], o.bounds[row])
        expert = MotionExpert.NO_EXPERT if o.experts is None else MotionExpert(int(o.experts[row]))
        yield [
            moment.stamp,
            f"{moment.seconds:.6f}",
            o.ids[row],
            ObstacleKind(int(o.kinds[row])).name,
            ObstacleShape(int(o.shapes[row])).name,
            *(f"{number:.9g}" for number in numbers),
            expert.name,
        ]


def _arm_row(moment: Moment, arm: ArmModel) -> list[Any]:
    assert moment.q is not None
    tool = forward_kinematics(arm, moment.q)[-1]
    numbers = (*moment.q, *tool[:3, 3], *quat_from_rotation(tool[:3, :3]))
    return [moment.stamp, f"{moment.seconds:.6f}", *(f"{number:.9g}" for number in numbers)]
