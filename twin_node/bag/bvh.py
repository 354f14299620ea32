"""Biovision `.bvh` motion capture files: a skeleton and its joint angles over time."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from twin_node.bag.log import BagError
from twin_node.bag.trajectories import Trajectories, checked, number, read_lines
from twin_node.scene import Float64

if TYPE_CHECKING:
    from scipy.spatial.transform import Rotation

_CHANNELS = tuple(f"{axis}{kind}" for kind in ("position", "rotation") for axis in "XYZ")


@dataclass
class BvhJoint:
    """One joint, or the end of a limb, as the file describes it."""

    name: str
    parent: int
    """-1 for the root."""
    is_end: bool = False
    """An end site: it gives the last bone its length and is no joint."""
    offset: Float64 = field(default_factory=lambda: np.zeros(3))
    """[3] from the parent where the channels say nothing, in the file's unit."""
    channels: tuple[str, ...] = ()
    """`Xposition` to `Zrotation` in the file's order."""


@dataclass(frozen=True)
class BvhClip:
    """A recorded motion in the file's own frame (y up) and unit."""

    joints: tuple[BvhJoint, ...]
    """[J], parents first."""
    frame_s: float
    """Time between two frames, s."""
    positions: Float64
    """[T, J, 3]."""


def read_clip(path: Path) -> BvhClip:
    """Every joint and limb's end of a `.bvh` file over time.

    Rotations are taken in the order of the channels, in degrees; position channels take the place of the joint's
    offset. Raises `BagError` naming the file and the line for what is no BVH.
    """
    lines = read_lines(path)
    joints, motion = _skeleton(path, lines)
    values, step = _motion(path, lines, motion, sum(len(joint.channels) for joint in joints))
    # Angles that are none have no rotation, and would not come as far as positions.
    positions = _positions(joints, values) if np.isfinite(values).all() else values
    if not np.isfinite(positions).all():
        raise BagError(f"{path}: expected finite numbers, found NaN or infinity; record or export the motion again")
    return BvhClip(tuple(joints), step, positions)


def read_bvh(path: Path, height_m: float) -> Trajectories:
    """Joint positions of a `.bvh` file, scaled so that the person is `height_m` tall; axes as in the file (y up).

    The person's height is the median over time of the vertical extent of all joints and ends: mostly upright is
    assumed. Raises `BagError` naming the file and the line for what is no BVH.
    """
    clip = read_clip(path)
    with np.errstate(over="ignore"):
        extent = float(np.median(np.ptp(clip.positions[:, :, 1], axis=1)))
    if not 0 < extent < np.inf:
        raise BagError(f"{path}: expected a skeleton with a height (y up), found one of height {extent}")
    chosen = [row for row, joint in enumerate(clip.joints) if not joint.is_end]
    names = tuple(clip.joints[row].name for row in chosen)
    times: Float64 = clip.frame_s * np.arange(len(clip.positions), dtype=np.float64)
    return checked(path, names, times, clip.positions[:, chosen] * (height_m / extent))


def _skeleton(path: Path, lines: list[str]) -> tuple[list[BvhJoint], int]:
    """The joints, parents first, and the line after MOTION."""
    if not lines or lines[0].strip() != "HIERARCHY":
        raise BagError(f"{path}: expected a .bvh file (first line 'HIERARCHY'); give a file of that kind")
    joints: list[BvhJoint] = []
    open_joints: list[int] = []
    for line, text in enumerate(lines[1:], start=2):
        words = text.split()
        match words:
            case [] | ["{"]:
                continue
            case ["ROOT" | "JOINT" | "End", name, *_]:
                parent = open_joints[-1] if open_joints else -1
                is_end = words[0] == "End"
                joints.append(BvhJoint(f"{joints[parent].name}End" if is_end and joints else name, parent, is_end))
                open_joints.append(len(joints) - 1)
            case ["OFFSET", *cells] if open_joints and len(cells) == 3:
                joints[open_joints[-1]].offset = np.array([number(path, line, cell) for cell in cells])
            case ["CHANNELS", count, *names] if (
                open_joints and set(names) <= set(_CHANNELS) and count == str(len(set(names))) == str(len(names))
            ):
                joints[open_joints[-1]].channels = tuple(names)
            case ["}"] if open_joints:
                open_joints.pop()
            case ["MOTION"] if joints and not open_joints:
                return joints, line
            case _:
                raise BagError(f"{path}: line {line}: expected a part of a BVH skeleton, found '{text.strip()[:40]}'")
    raise BagError(f"{path}: expected MOTION after the skeleton, found the end of the file; it is cut short")


def _motion(path: Path, lines: list[str], start: int, channels: int) -> tuple[Float64, float]:
    """Channel values [T, channels] and the time between frames in seconds."""
    header = [line.split(":")[-1].strip() for line in lines[start : start + 2]]
    if len(header) < 2 or not header[0].isdecimal() or not 0 < number(path, start + 2, header[1]) < np.inf:
        raise BagError(f"{path}: line {start + 1}: expected 'Frames: N' and 'Frame Time: seconds', found {header}")
    rows = []
    for line, text in enumerate(lines[start + 2 :], start=start + 3):
        cells = text.split()
        if not cells:
            continue
        if len(cells) != channels:
            raise BagError(f"{path}: line {line}: expected {channels} channel values, found {len(cells)}")
        rows.append([number(path, line, cell) for cell in cells])
    if len(rows) != int(header[0]):
        raise BagError(f"{path}: expected {header[0]} frames, found {len(rows)}; the file is cut short or was edited")
    if not channels or not rows:
        raise BagError(f"{path}: expected a motion, found {len(rows)} frames of {channels} channels; export it again")
    return np.array(rows), float(header[1])


def _positions(joints: list[BvhJoint], values: Float64) -> Float64:
    """Positions [T, joints, 3] by forward kinematics, in the file's unit."""
    from scipy.spatial.transform import Rotation  # loads slowly, and few read such files

    frames = len(values)
    positions = np.zeros((frames, len(joints), 3))
    turns: list[Rotation] = []
    columns: Iterator[Float64] = iter(values.T)
    for row, joint in enumerate(joints):
        own = {channel: next(columns) for channel in joint.channels}
        local = np.tile(joint.offset, (frames, 1))
        for axis, letter in enumerate("XYZ"):
            if f"{letter}position" in own:
                local[:, axis] = own[f"{letter}position"]
        order = [channel[0] for channel in joint.channels if channel.endswith("rotation")]
        turn = Rotation.identity(frames)
        if order:
            angles = np.stack([own[f"{letter}rotation"] for letter in order], axis=1)
            turn = Rotation.from_euler("".join(order), angles, degrees=True)
        if joint.parent >= 0:
            local = positions[:, joint.parent] + turns[joint.parent].apply(local)
            turn = turns[joint.parent] * turn
        positions[:, row] = local
        turns.append(turn)
    return positions
