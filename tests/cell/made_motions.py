"""Made-up motions of a person as motion capture files: what wrote `sim/*.bvh`.

Angles over time, in the proportions of `people.py`: no recording of anybody. Frame and unit are those of BVH: y up, z
forward, x to the left; here in metres for a person of 1.75 m.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np

from twin_node.cell.people import (
    FOREARM,
    HAND,
    HIP_HEIGHT,
    SHOULDER_TO_HEAD,
    SHOULDER_TO_HIP,
    SHOULDER_WIDTH,
    UPPER_ARM,
)
from twin_node.scene import Float64

_HEIGHT_M = 1.75
_RATE_HZ = 20.0
_THIGH, _SHANK, _FOOT, _HIP_WIDTH = 0.245, 0.246, 0.10, 0.13
"""Shares of the height (Winter, Biomechanics and Motor Control of Human Movement, fig. 4.1)."""


@dataclass(frozen=True)
class _Bone:
    """A joint of the made-up skeleton."""

    name: str
    parent: str
    offset: tuple[float, float, float]
    """From the parent, as shares of the height."""


def _limbs(side: str, sign: int) -> tuple[_Bone, ...]:
    arm, leg = sign * SHOULDER_WIDTH / 2, sign * _HIP_WIDTH / 2
    return (
        _Bone(f"{side}UpLeg", "Hips", (leg, 0.0, 0.0)),
        _Bone(f"{side}Leg", f"{side}UpLeg", (0.0, -_THIGH, 0.0)),
        _Bone(f"{side}Foot", f"{side}Leg", (0.0, -_SHANK, 0.0)),
        _Bone(f"{side}FootEnd", f"{side}Foot", (0.0, -0.02, _FOOT)),
        _Bone(f"{side}Arm", "Chest", (arm, SHOULDER_TO_HIP / 2, 0.0)),
        _Bone(f"{side}ForeArm", f"{side}Arm", (0.0, -UPPER_ARM, 0.0)),
        _Bone(f"{side}Hand", f"{side}ForeArm", (0.0, -FOREARM, 0.0)),
        _Bone(f"{side}HandEnd", f"{side}Hand", (0.0, -2 * HAND, 0.0)),
    )


_SKELETON = (
    _Bone("Hips", "", (0.0, HIP_HEIGHT, 0.0)),
    _Bone("Chest", "Hips", (0.0, SHOULDER_TO_HIP / 2, 0.0)),
    _Bone("Neck", "Chest", (0.0, SHOULDER_TO_HIP / 2, 0.0)),
    _Bone("Head", "Neck", (0.0, 0.6 * SHOULDER_TO_HEAD, 0.0)),
    _Bone("HeadEnd", "Head", (0.0, 0.6 * SHOULDER_TO_HEAD, 0.0)),
    *_limbs("Left", 1),
    *_limbs("Right", -1),
)

Angles = Mapping[str, Float64]
"""Joint -> turn about x over time [T], degrees; arms and legs hang at zero, and swing forward for negative angles."""


@dataclass(frozen=True)
class MadeMotion:
    """A motion to be written."""

    angles: Angles
    turns: Angles
    """The same about y, to the left."""
    ahead_m: Float64
    """[T] how far the hips have gone."""


def walk(duration_s: float = 5.0, speed: float = 1.3) -> MadeMotion:
    """Walks straight on, arms swinging: one gait cycle per 1.4 m, hips and knees as in normal gait."""
    t = _times(duration_s)
    phase = 2 * np.pi * speed / 1.4 * t
    angles = {}
    for side, begin in (("Left", 0.0), ("Right", np.pi)):
        swing = np.sin(phase + begin)
        angles[f"{side}UpLeg"] = -24 * swing
        angles[f"{side}Leg"] = 8 + 26 * (1 - np.cos(phase + begin + np.pi / 2))
        angles[f"{side}Arm"] = 22 * swing
        angles[f"{side}ForeArm"] = -18 + 8 * swing
    return MadeMotion(angles, {}, speed * t)


def reach() -> MadeMotion:
    """Stands, reaches forward and down with the right hand twice, the second time faster and farther to the left."""
    t = _times(6.0)
    first, second = _there_and_back(t, 0.8, 0.75, 0.7), _there_and_back(t, 3.4, 0.55, 0.5)
    both = first + second
    return MadeMotion(
        {
            "Chest": 32 * both,
            "RightArm": -8 - 62 * first - 68 * second,
            "RightForeArm": -20 + 8 * both,
            "LeftArm": -6 + 10 * both,
            "LeftForeArm": np.full(len(t), -14.0),
        },
        {"Chest": 24 * second},
        np.zeros(len(t)),
    )


def sort_parts() -> MadeMotion:
    """Bends over and moves parts from side to side with both hands, which the trunk's turns carry up to 1 m/s."""
    t = _times(7.0)
    bent = _there_and_back(t, 0.6, 0.9, 4.2)
    turns = 34 * bent * np.sin(2 * np.pi * 0.55 * (t - 1.5))
    return MadeMotion(
        {
            "Chest": 26 * bent,
            "RightArm": -6 - 58 * bent - 8 * bent * np.sin(2 * np.pi * 1.1 * t),
            "LeftArm": -6 - 58 * bent + 8 * bent * np.sin(2 * np.pi * 1.1 * t),
            "RightForeArm": -18 - 12 * bent,
            "LeftForeArm": -18 - 12 * bent,
        },
        {"Chest": turns},
        np.zeros(len(t)),
    )


MADE: Mapping[str, Callable[[], MadeMotion]] = {"walk": walk, "reach": reach, "sort_parts": sort_parts}
"""Name of the file in `sim/` -> what it holds."""


def write_bvh(motion: MadeMotion) -> str:
    """Text of a motion's BVH file."""
    lines = ["HIERARCHY", *_hierarchy("Hips", 0), "MOTION"]
    frames = len(motion.ahead_m)
    lines += [f"Frames: {frames}", f"Frame Time: {1 / _RATE_HZ:g}"]
    still = np.zeros(frames)
    columns = [still, np.full(frames, HIP_HEIGHT * _HEIGHT_M), motion.ahead_m]
    for name in _depth_first("Hips"):
        columns += [motion.turns.get(name, still), motion.angles.get(name, still)]
    rows = np.round(np.stack(columns, axis=1), 3) + 0.0
    return "\n".join([*lines, *(" ".join(f"{value:g}" for value in row) for row in rows), ""])


def _hierarchy(name: str, depth: int) -> list[str]:
    """The lines of a joint and of all that hangs on it; joints turn about y, then x."""
    bone = next(bone for bone in _SKELETON if bone.name == name)
    indent, children = "  " * depth, _children(name)
    label = f"JOINT {name}" if bone.parent else f"ROOT {name}"
    offset = " ".join(f"{share * _HEIGHT_M:.4f}" for share in bone.offset)
    lines = [f"{indent}{label if children else 'End Site'}", f"{indent}{{", f"{indent}  OFFSET {offset}"]
    if children:
        channels = "Yrotation Xrotation" if bone.parent else "Xposition Yposition Zposition Yrotation Xrotation"
        lines.append(f"{indent}  CHANNELS {len(channels.split())} {channels}")
    for child in children:
        lines += _hierarchy(child, depth + 1)
    return [*lines, f"{indent}}}"]


def _depth_first(name: str) -> list[str]:
    """A joint and those that hang on it, ends left out, in the order of the hierarchy's lines."""
    children = _children(name)
    return [name, *(below for child in children for below in _depth_first(child))] if children else []


def _children(name: str) -> list[str]:
    return [bone.name for bone in _SKELETON if bone.parent == name]


def _times(duration_s: float) -> Float64:
    return np.arange(round(duration_s * _RATE_HZ) + 1) / _RATE_HZ


def _there_and_back(t: Float64, start_s: float, move_s: float, stay_s: float) -> Float64:
    """0 to 1 and back to 0 over times [T], each way a minimum-jerk move (Flash and Hogan 1985)."""

    def moved(begin_s: float) -> Float64:
        s = np.clip((t - begin_s) / move_s, 0.0, 1.0)
        return np.asarray(s**3 * (10 - 15 * s + 6 * s**2))

    return moved(start_s) - moved(start_s + move_s + stay_s)
