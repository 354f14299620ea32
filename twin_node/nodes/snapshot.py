"""What had been said on every topic of a run by one time."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Protocol, TypeVar

import numpy as np

from twin_node.messages import Message, MessageError, convert, header_stamp
from twin_node.nodes.cloud_updates import updated
from twin_node.nodes.topics import (
    GAUSSIANS,
    GAUSSIANS_CHANGED,
    GAUSSIANS_MOVING,
    JOINT_STATES,
    OBSTACLES,
    OCCUPANCY,
    SEPARATION,
    STATUS,
    TRAJECTORY,
    CameraTopics,
)
from twin_node.rig import DecodedImage, FrameAssembler
from twin_node.scene import (
    Bool,
    GaussianCloud,
    JointPath,
    JointSample,
    Obstacles,
    ObstacleShape,
    Occupancy,
    Separation,
    View,
)

SILENT_S = 2.5
"""Longer than this neither twin nor arm are silent, s: their slowest words come once a second."""
Read = TypeVar("Read")


class Said(Protocol):
    """A message and when it was said."""

    @property
    def stamp(self) -> int:
        """ns."""

    @property
    def message(self) -> Message:
        """As it was published."""


AnySaid = TypeVar("AnySaid", bound=Said)

Earlier = Callable[[str, int], Sequence[Said]]
"""What was said on a topic in so many ns before a time, and at it, oldest first."""


JointsWith = Callable[[frozenset[str]], Said | None]
"""The newest joints among which are all of some names; None before the first.

Raises `LookupError` where they never come, or none have come for as long as anybody remembers.
"""


def _nothing(_topic: str, _ns: int) -> Sequence[Said]:
    return ()


def _never(_names: frozenset[str]) -> Said | None:
    raise LookupError


LONGEST_MOVE_S = 0.2
"""How far Gaussians and joints are moved on at their velocities, s: as far as the twin foresees."""


@dataclass(frozen=True)
class Snapshot:
    """What had been said by `stamp`; every part is decoded when it is first asked for, None where it was never said.

    Whatever is asked for raises `MessageError`, which names topic and time, where a message is damaged or says what
    cannot be.
    """

    stamp: int
    """Log time, ns."""
    said: Mapping[str, Said]
    """The newest message of each topic."""
    cameras: Mapping[str, CameraTopics]
    assembler: FrameAssembler | None
    earlier: Earlier = _nothing
    joints_with: JointsWith = _never

    def _newest(self, topic: str, read: Callable[[Message], Read]) -> Read | None:
        """What a topic's newest message says."""
        said = self.said.get(topic)
        return None if said is None else _read(topic, said, read)

    @cached_property
    def cloud(self) -> GaussianCloud | None:
        """All Gaussians as they were published: the last whole cloud, what has changed since, and what moves."""
        whole, since = self._newest(GAUSSIANS, convert.gaussians_from_pointcloud2), self.whole_stamp
        if whole is None or since is None:
            return self._newest(GAUSSIANS_MOVING, convert.gaussians_from_pointcloud2)

        def later(topic: str) -> GaussianCloud | None:
            stamp = self._newest(topic, header_stamp)
            return None if stamp is None or stamp <= since else self._newest(topic, convert.gaussians_from_pointcloud2)

        return updated(whole, later(GAUSSIANS_CHANGED), later(GAUSSIANS_MOVING))

    def cloud_at(self, stamp: int) -> GaussianCloud | None:
        """All Gaussians, moved on at their velocities from the set that they follow to a time near it, ns.

        So a model that is some sets late is shown beside images and arm as it would be there.
        """
        cloud, followed = self.cloud, self.followed_stamp
        if cloud is None or followed is None:
            return None
        seconds = (stamp - followed) * 1e-9
        return cloud.moved(min(max(seconds, -LONGEST_MOVE_S), LONGEST_MOVE_S))

    @property
    def followed_stamp(self) -> int | None:
        """Stamp of the set that all Gaussians follow, ns."""
        stamps = (self._newest(topic, header_stamp) for topic in (GAUSSIANS, GAUSSIANS_MOVING))
        return max((stamp for stamp in stamps if stamp is not None), default=None)

    @property
    def cloud_now(self) -> GaussianCloud | None:
        """All Gaussians, moved on to the time of the snapshot."""
        return self.cloud_at(self.stamp)

    @cached_property
    def whole_stamp(self) -> int | None:
        """Evidence stamp of the last whole cloud, ns."""
        return self._newest(GAUSSIANS, header_stamp)

    @cached_property
    def occupancy(self) -> Occupancy | None:
        """The newest forecast of occupied space."""
        return self._newest(OCCUPANCY, convert.occupancy_from_message)

    @property
    def foreseen(self) -> Occupancy | None:
        """The newest forecast while it lasts: after its last horizon nobody says any more what moves where."""
        newest = self.occupancy
        if newest is None or not newest.layers:
            return None
        return newest if self.stamp <= newest.publish_stamp + newest.layers[-1].horizon_ns else None

    @cached_property
    def obstacles(self) -> Obstacles | None:
        """The newest obstacles, of every interval of their validity."""
        return self._newest(OBSTACLES, placed_obstacles)

    @cached_property
    def separation(self) -> Separation | None:
        """The newest decision about the arm's speed."""
        return self._newest(SEPARATION, convert.separation_from_message)

    @cached_property
    def status(self) -> convert.Status | None:
        """The newest word of the twin about itself."""
        return self._newest(STATUS, convert.status_from_message)

    @cached_property
    def joints(self) -> JointSample | None:
        """The newest joints: an arm's, a gripper's or an axis'; see `joints_of`."""
        return self._newest(JOINT_STATES, convert.joint_sample_from_message)

    def joints_of(self, names: Collection[str]) -> JointSample | None:
        """The newest joints among which are all of `names`: a gripper's come on the same topic as the arm's.

        None before the first. Where they never come, or none have come for as long as anybody remembers, the newest of
        all, whose names tell what came instead.
        """
        newest, wanted = self.joints, frozenset(names)
        if newest is None or wanted.issubset(newest.names):
            return newest
        try:
            said = self.joints_with(wanted)
        except LookupError:
            return newest
        return None if said is None else _read(JOINT_STATES, said, convert.joint_sample_from_message)

    def joints_at(self, names: Collection[str], stamp: int) -> JointSample | None:
        """`joints_of`, moved on at their velocities to a time near their own, ns; as they are at any other.

        An image that has just come is older than the joints that have: beside it the arm is where it was then.
        """
        joints = self.joints_of(names)
        if joints is None or abs(stamp - joints.stamp) > LONGEST_MOVE_S * 1e9:
            return joints
        return joints.at(stamp)

    @cached_property
    def path(self) -> JointPath | None:
        """Where the arm means to be, while that lasts: a path that has not begun or is over tells nothing of it.

        Nor does one without points, by which ROS's trajectory controllers are told to stay where they are.
        """
        said = self.said.get(TRAJECTORY)
        if said is None or not _read(TRAJECTORY, said, lambda message: len(message.points)):
            return None
        path = _read(TRAJECTORY, said, lambda message: convert.joint_path_from_message(message, said.stamp))
        return path if path.stamps[0] <= self.stamp <= path.stamps[-1] else None

    def silent_s(self, topics: Sequence[str]) -> float:
        """For how long nothing was said on any of some topics, s; 0 where nothing ever was."""
        stamps = [self.said[topic].stamp for topic in topics if topic in self.said]
        return (self.stamp - max(stamps)) / 1e9 if stamps else 0.0

    def camera_silent_s(self, camera: str) -> float:
        """For how long the camera has sent no image, s; 0 where it never sent one."""
        return self.silent_s((self.cameras[camera].image,))

    def view(self, camera: str) -> View | None:
        """A camera's newest image, undistorted; it is decoded anew whenever it is asked for.

        Raises `RigError` for an image that is not of the calibrated size.
        """
        image = self._newest(self.cameras[camera].image, _decoded)
        return None if image is None or self.assembler is None else self.assembler.view(camera, image)


def newest_joints(told: Sequence[AnySaid], names: frozenset[str]) -> AnySaid | None:
    """The newest of some joints, oldest first, among which are all of some names; None where none are."""
    for said in reversed(told):
        if names.issubset(_read(JOINT_STATES, said, convert.joint_sample_from_message).names):
            return said
    return None


def _read(topic: str, said: Said, read: Callable[[Message], Read]) -> Read:
    """What a message says. Raises `MessageError` that names topic and time of one that says what cannot be."""
    try:
        return read(said.message)
    except MessageError as error:
        raise type(error)(f"{topic} at {said.stamp / 1e9:.3f} s: {error}") from None


def _decoded(message: Message) -> DecodedImage:
    return DecodedImage(header_stamp(message), convert.rgb_from_message(message), None)


def placed_obstacles(message: Message) -> Obstacles:
    """What a message says. Raises `MessageError` for obstacles that are nowhere, of sizes below 0 or of no turn."""
    told = convert.obstacles_from_message(message)
    is_ball: Bool = told.shapes == ObstacleShape.SPHERE
    has_turn: Bool = (told.quats != 0).any(axis=1)
    numbers = np.column_stack([told.positions, told.quats, told.sizes])
    has_size = np.asarray((told.sizes >= 0).all(axis=1))
    sound = np.isfinite(numbers).all(axis=1) & has_size & (has_turn | is_ball)
    if not sound.all():
        raise MessageError(
            "ObstacleArray: expected finite numbers, sizes of 0 or more and quaternions that are not 0, found others "
            f"in {np.sum(~sound)} of {len(sound)} obstacles, the first of id {told.ids[sound.argmin()]}; the sender "
            "is at fault"
        )
    return told if has_turn.all() else replace(told, quats=np.where(has_turn[:, None], told.quats, [1.0, 0, 0, 0]))


def in_force(obstacles: Obstacles | None, stamp: int) -> Obstacles:
    """The obstacles whose validity holds `stamp` (ns), or the first of it where all begin later; none of none.

    A forecast begins when it can be acted on: in lockstep that is the assumed latency after its log time.
    """
    if obstacles is None or not len(obstacles.ids):
        return Obstacles.none()
    at = max(stamp, obstacles.begins)
    return obstacles.only((obstacles.valid_from <= at) & (at <= obstacles.valid_to))
