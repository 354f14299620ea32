"""What the small log of a twin says at each of its moments: known values, made by hand."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from mcap.writer import Writer

from twin_node.bag import LogWriter, open_log
from twin_node.messages import convert, from_time
from twin_node.nodes.topics import GAUSSIANS, GAUSSIANS_MOVING, JOINT_STATES, OBSTACLES
from twin_node.scene import GaussianCloud, JointSample, ObstacleKind, Obstacles, ObstacleShape, Tier

START = 1_700_000_000_000_000_000
PERIOD = 100_000_000
MOMENTS = 15
LATENCY = 33_000_000
"""Forecasts begin so long after the log time, as in lockstep."""


def cloud_at(k: int, with_static: bool) -> GaussianCloud:
    """Forty standing Gaussians, the same at all times, and ten that have moved k steps of 1 cm along x."""
    rng = np.random.default_rng(0)
    n = 50
    quats = rng.normal(size=(n, 4))
    tiers = np.array([Tier.STATIC] * 40 + [Tier.RIGID] * 10, np.uint8)
    moving = tiers == Tier.RIGID
    means = rng.uniform(-0.5, 0.5, (n, 3)) + np.array([1.0, 0, 0.5])
    means[moving, 0] += 0.01 * k
    whole = GaussianCloud(
        means=means.astype(np.float32),
        quats=(quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        scales=rng.uniform(0.005, 0.03, (n, 3)).astype(np.float32),
        opacities=rng.uniform(0.1, 0.95, n).astype(np.float32),
        rgb=(rng.integers(0, 256, (n, 3)) / 255).astype(np.float32),
        velocities=(moving[:, None] * np.array([0.1, 0, 0])).astype(np.float32),
        tiers=tiers,
        ids=np.arange(n, dtype=np.uint32),
        nodes=np.full(n, -1, np.int32),
    )
    return whole if with_static else whole.only(moving)


def obstacles_at(k: int, stamp: int) -> Obstacles:
    """A turned box and a sphere that move, a floor that stands, now and in the next interval; clear of the arm."""
    now, later = stamp + LATENCY, stamp + LATENCY + 50_000_000
    shift = np.array([0.01 * k, 0, 0])
    turn = np.array([np.cos(0.3), 0, 0, np.sin(0.3)])
    positions = [np.array([0.9, 0.4, 0.5]) + shift, np.array([0.8, -0.6, 0.7]) - shift, np.array([0, 0, -0.4])]
    sizes = np.array([[0.1, 0.2, 0.3 + 0.02 * (k % 2)], [0.16, 0.16, 0.16], [2.0, 2.0, 0.1]])
    kinds = np.array([ObstacleKind.MOVING, ObstacleKind.MOVING, ObstacleKind.STATIC], np.uint8)
    shapes = np.array([ObstacleShape.BOX, ObstacleShape.SPHERE, ObstacleShape.BOX], np.uint8)
    return Obstacles(
        stamp=stamp,
        ids=np.tile(np.array([7, 8, 9], np.uint32), 2),
        kinds=np.tile(kinds, 2),
        shapes=np.tile(shapes, 2),
        positions=np.concatenate([positions, np.array(positions) + 0.005]),
        quats=np.tile(np.array([turn, [1, 0, 0, 0], [1, 0, 0, 0]]), (2, 1)),
        sizes=np.tile(sizes, (2, 1)),
        velocities=np.zeros((6, 3)),
        bounds=np.full(6, 0.02),
        valid_from=np.repeat([now, later], 3),
        valid_to=np.repeat([later - 1, later + 49_999_999], 3),
    )


def write_twin_log(path: Path) -> None:
    """A log of 1.5 s at 10 Hz: whole clouds at the start and after 1 s, moving ones, obstacles and joints always."""
    names = tuple(
        f"{joint}_joint" for joint in ("shoulder_pan", "shoulder_lift", "elbow", "wrist_1", "wrist_2", "wrist_3")
    )
    with LogWriter(path) as log:
        for k in range(MOMENTS):
            stamp = START + k * PERIOD
            q = np.array([0.1 * k, -1.2, 1.4, -1.8, -1.5, 0.0])
            joints = convert.joint_sample_to_message(JointSample(stamp, names, q, np.zeros(6)))
            if k % 10 == 0:
                log.write(GAUSSIANS, convert.gaussians_to_pointcloud2(cloud_at(k, True), stamp), stamp)
            log.write(GAUSSIANS_MOVING, convert.gaussians_to_pointcloud2(cloud_at(k, False), stamp), stamp)
            log.write(OBSTACLES, convert.obstacles_to_message(obstacles_at(k, stamp)), stamp)
            log.write(JOINT_STATES, joints, stamp)


def with_gripper(log: Path, path: Path) -> Path:
    """Copies a log, and has a gripper tell of its joint where the arm does, with the very stamps of the images."""
    with open_log(log) as read, LogWriter(path) as written:
        for message in read.messages():
            if "image_raw" in message.topic:
                stamp = from_time(message.message.header.stamp)
                finger = JointSample(stamp, ("finger_joint",), np.zeros(1), np.zeros(1))
                written.write(JOINT_STATES, convert.joint_sample_to_message(finger), message.stamp)
            written.write_raw(message.topic, message.msgtype, message.data, message.stamp)
    return path


def with_notes(log: Path, path: Path) -> Path:
    """A log, and a topic /notes in JSON, which nobody here reads."""
    with open_log(log) as read, path.open("wb") as file:
        writer = Writer(file)
        writer.start("ros2", "test")
        for name, record in read.metadata.items():
            writer.add_metadata(name, dict(record))
        channels = {}
        for topic in read.topics:
            text = read.types_of(topic.name).definition(topic.msgtype).encode()
            schema = writer.register_schema(topic.msgtype, "ros2msg", text)
            channels[topic.name] = writer.register_channel(topic.name, "cdr", schema)
        notes = writer.register_channel("/notes", "json", writer.register_schema("note", "jsonschema", b"{}"))
        for message in read.messages():
            writer.add_message(channels[message.topic], message.stamp, bytes(message.data), message.stamp)
        writer.add_message(notes, read.start_ns, b"{}", read.start_ns)
        writer.finish()
    return path
