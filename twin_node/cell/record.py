"""Writes a scenario as a log that cannot be told from one of a real cell, plus the truth."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from heapq import merge
from pathlib import Path
from typing import Literal

import numpy as np

from twin_node.bag import LogWriter, write_rig
from twin_node.cell.scenario import Scenario
from twin_node.cell.sensor import RawImage
from twin_node.cell.simulator import SimulatedRig
from twin_node.cell.truth import CellTruth
from twin_node.messages import Message
from twin_node.messages.convert import (
    camera_info,
    compressed_image,
    depth_image,
    joint_path_to_message,
    joint_sample_to_message,
    occupancy_to_message,
)
from twin_node.scene import Rig

TRAJECTORY_RATE_HZ = 10.0
"""Rate of `/arm/trajectory`; each message reaches 0.5 s ahead."""

LEAST_TRUTH_RATE_HZ = 20.0
"""Rate of `/truth/occupancy` at least, whatever the cameras': a forecast is judged by a truth of about its own time."""

SCENARIO_METADATA = "twin_node.scenario"
"""Metadata record with the scenario's `name` and `seed`: where the log comes from."""

COMPRESSION: Literal["zstd"] = "zstd"
"""Of the log's chunks: raw depth shrinks to a third."""

Progress = Callable[[int, int], None]
"""Told the number of messages written and of all messages."""


@dataclass(frozen=True)
class Entry:
    """One message of the log."""

    stamp: int
    """When it is recorded, ns."""
    topic: str
    message: Message


def write_log(scenario: Scenario, path: Path, progress: Progress | None = None) -> None:
    """Record a whole scenario: images, depth, calibration, the arm's joints and path, and `/truth/occupancy`.

    The same scenario gives the same bytes. Raises `CellError` for what is wrong with the scenario and `BagError` where
    the log cannot be written; nothing is left at `path` then.
    """
    recording = Recording(scenario)
    with LogWriter(path, COMPRESSION) as writer:
        write_rig(writer, recording.rig, scenario.start_ns)
        writer.add_metadata(SCENARIO_METADATA, {"name": scenario.name, "seed": str(scenario.seed)})
        for done, entry in enumerate(recording.entries(), start=1):
            writer.write(entry.topic, entry.message, entry.stamp)
            if progress is not None:
                progress(done, recording.count)


class Recording:
    """The messages of a scenario in rising order of time."""

    def __init__(self, scenario: Scenario) -> None:
        self._scenario = scenario
        self._simulated = SimulatedRig(scenario)
        self._truth = CellTruth(self._simulated)
        self._exposures = self._simulated.arrivals()

    @property
    def rig(self) -> Rig:
        """The calibrated cameras and the workspace."""
        return self._simulated.rig

    @property
    def count(self) -> int:
        """Number of all messages."""
        arm = self._scenario.arm
        joints = 0 if arm is None else len(self._times(arm.joint_rate_hz)) + len(self._times(TRAJECTORY_RATE_HZ))
        return 3 * len(self._exposures) + joints + len(self._truth_stamps())

    def entries(self) -> Iterator[Entry]:
        """All messages, made as they are asked for."""
        streams = (self._joint_states(), self._trajectory(), self._occupancy(), self._images())
        yield from merge(*streams, key=lambda entry: entry.stamp)

    def _images(self) -> Iterator[Entry]:
        for exposure in self._exposures:
            image = self._simulated.take(exposure)
            camera, stamp = self._simulated.rig.cameras[exposure.camera], image.stamp
            yield Entry(exposure.arrival, f"/{camera.name}/camera_info", camera_info(camera, stamp))
            colour = compressed_image(camera.name, stamp, image.rgb)
            yield Entry(exposure.arrival, f"/{camera.name}/image_raw/compressed", colour)
            yield Entry(exposure.arrival, f"/{camera.name}/depth/image_rect", _depth(image))

    def _joint_states(self) -> Iterator[Entry]:
        arm = self._simulated.world.arm
        if arm is None or self._scenario.arm is None:
            return
        for stamp in self._times(self._scenario.arm.joint_rate_hz):
            yield Entry(stamp, "/joint_states", joint_sample_to_message(arm.sample(stamp)))

    def _trajectory(self) -> Iterator[Entry]:
        arm = self._simulated.world.arm
        if arm is None:
            return
        for stamp in self._times(TRAJECTORY_RATE_HZ):
            yield Entry(stamp, "/arm/trajectory", joint_path_to_message(arm.ahead(stamp)))

    def _occupancy(self) -> Iterator[Entry]:
        for stamp in self._truth_stamps():
            yield Entry(stamp, "/truth/occupancy", occupancy_to_message(self._truth.occupancy(stamp)))

    def _truth_stamps(self) -> list[int]:
        """Of every image set, and evenly between them where these are rare, ns."""
        ticks = np.array(self._simulated.tick_stamps(), np.int64)
        parts = math.ceil(LEAST_TRUTH_RATE_HZ / self._scenario.sensing.rate_hz - 1e-6)
        if parts < 2 or not len(ticks):
            return [int(stamp) for stamp in ticks]
        at = np.arange((len(ticks) - 1) * parts + 1) / parts
        passed = np.interp(at, np.arange(len(ticks)), ticks - ticks[0])
        return [int(ticks[0]) + round(ns) for ns in passed]

    def _times(self, rate_hz: float) -> list[int]:
        """Stamps before the scenario's end, ns; 1.1 s at 100 Hz are 110, though their product is a little more."""
        count = int(np.ceil(self._scenario.duration_s * rate_hz - 1e-6))
        return [self._scenario.start_ns + round(i * 1e9 / rate_hz) for i in range(count)]


def _depth(image: RawImage) -> Message:
    if image.depth_is_nan:
        return nan_depth(image, image.stamp)
    return depth_image(image.camera, image.stamp, image.depth_m, "16UC1")


def nan_depth(image: RawImage, stamp: int) -> Message:
    """Depth in 32FC1, all NaN, as a camera sends it at a stamp (ns) under the fault `nan_depth`."""
    nothing = np.full(image.depth_mm.shape, np.nan, np.float32)
    return replace(depth_image(image.camera, stamp, nothing, "32FC1"), data=nothing.reshape(-1).view(np.uint8))
