"""What an arm is: joints, limits and the capsules that enclose its links. Nothing here changes while it moves."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from twin_node.errors import TwinError
from twin_node.geometry import transform
from twin_node.scene import Float64, JointSample

FARTHEST_RAD = 1e6
"""No joint turns so far, nor so fast in a second: with angles beyond it times and places become infinite."""


FARTHEST_M = 10.0
"""No link of an arm reaches so far from its joint, nor is the next one so far away: more are millimetres."""


class RobotError(TwinError):
    """An arm's model, joint values or kinematics file is wrong."""


@dataclass(frozen=True)
class Capsules:
    """Capsules fixed to the links of an arm; equal ends make a sphere."""

    links: NDArray[np.int64]
    """[C] index of the link that carries each."""
    ends: Float64
    """[C, 2, 3] m, in the link's frame."""
    radii: Float64
    """[C] m."""

    def __len__(self) -> int:
        return len(self.radii)

    def joined(self, other: Capsules) -> Capsules:
        """These and the other's capsules."""
        return Capsules(
            np.concatenate([self.links, other.links]),
            np.concatenate([self.ends, other.ends]),
            np.concatenate([self.radii, other.radii]),
        )


@dataclass(frozen=True)
class ArmModel:
    """A serial arm of revolute joints, standing at `base_link`.

    Link 0 is `base_link` itself; link j turns about the z axis of its own frame by joint j - 1. For a UR arm these are
    the link frames of UR's ROS description, so the last link is `tool0` too; others say where that is.
    """

    name: str
    link_names: tuple[str, ...]
    """[J + 1]."""
    joint_names: tuple[str, ...]
    """[J]."""
    origins: Float64
    """[J, 4, 4] pose of joint j at angle zero in the frame of the link before it."""
    lower: Float64
    """[J] rad."""
    upper: Float64
    """[J] rad."""
    max_velocity: Float64
    """[J] ratings, rad/s: what no plan may exceed. An arm's file may give less than the arm does."""
    max_acceleration: Float64
    """[J] rad/s^2."""
    capsules: Capsules
    never_meet: tuple[tuple[str, str], ...] = ()
    """Pairs of links, not neighbours, that cannot touch however the joints turn, though their capsules may overlap."""
    T_last_tool: Float64 = field(default_factory=lambda: np.eye(4))
    """[4, 4] pose of `tool0`, the frame of tools, in that of the last link."""

    def __post_init__(self) -> None:
        """Raises `RobotError` for links in millimetres: they would hide all that cameras see, or be nowhere near it."""
        reaches = np.zeros(len(self.link_names))
        reaches[1 : self.joints] = np.linalg.norm(self.origins[1:, :3, 3], axis=1)
        shapes = np.linalg.norm(self.capsules.ends, axis=2).max(axis=1) + self.capsules.radii
        np.maximum.at(reaches, self.capsules.links, shapes)
        far = np.flatnonzero(~(reaches[1:] <= FARTHEST_M)) + 1  # what stands at the base may be as large as it is
        if len(far):
            raise RobotError(
                f"arm {self.name}: expected link {self.link_names[far[0]]} in metres, at most {FARTHEST_M:g}, found "
                f"one of {reaches[far[0]]:.3g}; give metres, and meshes of millimetres a scale of 0.001"
            )

    @property
    def joints(self) -> int:
        """Number of joints."""
        return len(self.joint_names)

    def carrying(self, ends: Float64, radii: Float64) -> ArmModel:
        """The same with capsules on its last link: `ends` [n, 2, 3] m in the frame of `tool0`, `radii` [n] m.

        Raises `RobotError` for what makes no capsules: by a radius below 0 all would seem farther away than it is.
        """
        ends, radii = np.asarray(ends, np.float64), np.asarray(radii, np.float64)
        if radii.ndim != 1 or ends.shape != (len(radii), 2, 3) or not (np.isfinite(ends).all() and (radii > 0).all()):
            raise RobotError(
                f"carried by {self.name}: expected finite ends [n, 2, 3] and radii [n] above 0, in metres, found "
                f"{ends.shape}, {radii.shape} and radii {radii.tolist()}; give two ends and a radius per capsule"
            )
        carried = Capsules(np.full(len(radii), self.joints), transform(self.T_last_tool, ends), radii)
        return replace(self, capsules=self.capsules.joined(carried))

    def order(self, names: Sequence[str], values: NDArray[np.floating]) -> Float64:
        """Values [..., n] given under `names` as [..., J] in the model's own order: drivers publish joints in any.

        Raises `RobotError` where a joint or its value is missing, or a value is not finite or beyond `FARTHEST_RAD`.
        """
        missing = [name for name in self.joint_names if name not in names]
        if missing:
            advice = f"publish {', '.join(missing)} too, or choose another arm than {self.name}"
            if prefixed := self._prefixed(names):
                called = ", ".join(prefixed[0])
                advice = f"say that they are called so: 'arm.joints: [{called}]', or in the arm's own file"
            raise RobotError(
                f"joint values: expected {', '.join(self.joint_names)}, found {', '.join(names) or 'none'}; {advice}"
            )
        given = np.asarray(values, dtype=np.float64)
        if given.ndim == 0 or given.shape[-1] != len(names):
            raise RobotError(
                f"joint values: expected one per name ({', '.join(names)}), found shape {given.shape}; give as many "
                "values as names, zeros for velocities that nobody measures"
            )
        ordered = given[..., [list(names).index(name) for name in self.joint_names]]
        _refuse_wild(ordered)
        return ordered

    def called_as(self, names: Sequence[str]) -> ArmModel:
        """The same arm, its joints as these names have them: as its own file does, or with one prefix before them all.

        Raises `RobotError` where they are no such arm's, or several.
        """
        if set(self.joint_names) <= set(names):
            return self
        prefixed = self._prefixed(names)
        if len(prefixed) != 1:
            raise RobotError(
                f"joints: expected those of one {self.name}, {', '.join(self.joint_names)}, each with a prefix if its "
                f"driver gives it one, found {', '.join(names) or 'none'}; give the arm's own file, or record them"
            )
        return replace(self, joint_names=prefixed[0])

    def _prefixed(self, names: Sequence[str]) -> list[tuple[str, ...]]:
        """The arm's joints under names of these that have one prefix before them all, once for each such prefix."""
        first = self.joint_names[0]
        prefixes = (name.removesuffix(first) for name in names if name.endswith(first))
        called = (tuple(prefix + joint for joint in self.joint_names) for prefix in prefixes)
        return [joints for joints in called if set(joints) <= set(names)]

    def random_positions(self, generator: np.random.Generator, count: int) -> Float64:
        """Angles [count, J] (rad) in the joints' ranges, at most half a turn from what these have nearest to zero."""
        middle = np.clip(0.0, self.lower, self.upper)
        low, high = np.maximum(self.lower, middle - np.pi), np.minimum(self.upper, middle + np.pi)
        return generator.uniform(low, high, (count, self.joints))

    def ordered_positions(self, sample: JointSample) -> Float64:
        """Angles [J] of a sample in the model's own order; raises `RobotError` as `order` does."""
        return self.order(sample.names, sample.positions)

    def check_positions(self, q: NDArray[np.floating]) -> Float64:
        """Angles [..., J] as float64; raises `RobotError` for a wrong count, or a value that no joint has."""
        angles = np.asarray(q, dtype=np.float64)
        if angles.ndim == 0 or angles.shape[-1] != self.joints:
            raise RobotError(f"joint values: expected {self.joints} angles for {self.name}, found shape {angles.shape}")
        _refuse_wild(angles)
        return angles


def _refuse_wild(values: Float64) -> None:
    is_wild = ~(np.abs(values) <= FARTHEST_RAD)
    if is_wild.any():
        raise RobotError(
            f"joint values: expected finite angles of at most {FARTHEST_RAD:g} rad, found {values[is_wild][0]:g}; "
            "check the arm's driver"
        )
