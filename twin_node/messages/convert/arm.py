"""The arm: joint samples, trajectories and separation to messages and back."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np

from twin_node.messages.convert.camera import BASE_FRAME
from twin_node.messages.stamps import from_duration, from_time, header, header_stamp, to_duration, to_time
from twin_node.messages.types import Message, MessageError, message_type
from twin_node.scene import JointPath, JointSample, Separation


def joint_sample_to_message(sample: JointSample) -> Message:
    """`sensor_msgs/msg/JointState` of a sample; rad and rad/s, no efforts."""
    return message_type("sensor_msgs/msg/JointState")(
        header=header(sample.stamp, ""),
        name=list(sample.names),
        position=np.ascontiguousarray(sample.positions, dtype=np.float64),
        velocity=np.ascontiguousarray(sample.velocities, dtype=np.float64),
        effort=np.zeros(0),
    )


def joint_sample_from_message(message: Message) -> JointSample:
    """Sample from a `sensor_msgs/msg/JointState`; velocities are 0 where the message has none, see `has_velocities`.

    NaN is what ros2_control's joint_state_broadcaster has for what a joint does not tell: joints with such positions
    are left out, and all of a message without positions (a belt's speed, a gripper's force). Raises `MessageError`
    where names and positions differ in number, no joint's position is a number, or a value is infinite.
    """
    names = tuple(message.name)
    positions = np.array(message.position, dtype=np.float64)
    if not len(positions):
        return JointSample(header_stamp(message), (), np.zeros(0), np.zeros(0))
    velocities = np.array(message.velocity, dtype=np.float64) if len(message.velocity) else np.zeros(len(names))
    if not len(names) == len(positions) == len(velocities):
        raise MessageError(
            f"JointState at {header_stamp(message)} ns: {len(names)} names, {len(positions)} positions, "
            f"{len(velocities)} velocities; expected as many of each"
        )
    told = ~np.isnan(positions)
    if np.isinf(positions).any() or np.isinf(velocities).any() or not told.any():
        raise MessageError(f"JointState at {header_stamp(message)} ns: a position or velocity is not finite")
    return JointSample(
        stamp=header_stamp(message),
        names=tuple(name for name, is_told in zip(names, told, strict=True) if is_told),
        positions=positions[told],
        velocities=np.nan_to_num(velocities[told], nan=0.0),
    )


def has_velocities(message: Message, joints: Collection[str]) -> bool:
    """Whether a `sensor_msgs/msg/JointState` tells the velocities of all of some joints that it tells of."""
    told = dict(zip(message.name, message.velocity, strict=False))
    return all(name in told and not np.isnan(told[name]) for name in message.name if name in joints)


def joint_path_to_message(path: JointPath) -> Message:
    """`trajectory_msgs/msg/JointTrajectory` of a path: stamped with its first time, points relative to it."""
    point = message_type("trajectory_msgs/msg/JointTrajectoryPoint")
    start = int(path.stamps[0])
    points = [
        point(
            positions=np.ascontiguousarray(positions, dtype=np.float64),
            velocities=np.zeros(0),
            accelerations=np.zeros(0),
            effort=np.zeros(0),
            time_from_start=to_duration(int(stamp) - start),
        )
        for stamp, positions in zip(path.stamps, path.positions, strict=True)
    ]
    return message_type("trajectory_msgs/msg/JointTrajectory")(
        header=header(start, ""), joint_names=list(path.names), points=points
    )


def joint_path_from_message(message: Message, received: int) -> JointPath:
    """Path over absolute time from a `trajectory_msgs/msg/JointTrajectory`.

    A zero stamp means "now" (JointTrajectory.msg): `received`, ns, stands in for it. Raises `MessageError` for an empty
    trajectory, times that do not rise, and points with a wrong number of positions.
    """
    names = tuple(message.joint_names)
    if not message.points:
        raise MessageError("JointTrajectory: expected at least one point, found none")
    for index, point in enumerate(message.points):
        if len(point.positions) != len(names):
            raise MessageError(
                f"JointTrajectory point {index}: {len(point.positions)} positions for {len(names)} joints "
                f"({', '.join(names)})"
            )
    offsets = np.array([from_duration(point.time_from_start) for point in message.points], dtype=np.int64)
    falls = np.flatnonzero(np.diff(offsets) <= 0)
    if len(falls):
        raise MessageError(
            f"JointTrajectory point {falls[0] + 1}: time_from_start {offsets[falls[0] + 1] / 1e9:g} s is not after "
            f"{offsets[falls[0]] / 1e9:g} s of the point before; give rising times"
        )
    return JointPath(
        names=names,
        stamps=(header_stamp(message) or received) + offsets,
        positions=np.array([point.positions for point in message.points], dtype=np.float64),
    )


def separation_to_message(separation: Separation) -> Message:
    """`twin_msgs/msg/SeparationState` of a separation."""
    return message_type("twin_msgs/msg/SeparationState")(
        header=header(separation.stamp, BASE_FRAME),
        evidence_stamp=to_time(separation.evidence_stamp),
        distance=float(separation.distance),
        required=float(separation.required),
        term_human=float(separation.term_human),
        term_reaction=float(separation.term_reaction),
        term_stopping=float(separation.term_stopping),
        term_intrusion=float(separation.term_intrusion),
        term_uncertainty=float(separation.term_uncertainty),
        link=separation.link,
        obstacle_id=int(separation.obstacle_id),
        speed_fraction=float(separation.speed_fraction),
        reason=separation.reason,
    )


def separation_from_message(message: Message) -> Separation:
    """Separation from a `twin_msgs/msg/SeparationState`."""
    return Separation(
        stamp=header_stamp(message),
        evidence_stamp=from_time(message.evidence_stamp),
        distance=message.distance,
        required=message.required,
        term_human=message.term_human,
        term_reaction=message.term_reaction,
        term_stopping=message.term_stopping,
        term_intrusion=message.term_intrusion,
        term_uncertainty=message.term_uncertainty,
        link=message.link,
        obstacle_id=message.obstacle_id,
        speed_fraction=message.speed_fraction,
        reason=message.reason,
    )
