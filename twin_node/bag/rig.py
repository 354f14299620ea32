"""The calibrated rig as a log carries it: `/tf_static`, and a metadata record for what ROS has no field for."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from twin_node.bag.log import BagError
from twin_node.bag.reader import LogReader
from twin_node.bag.writer import LogWriter
from twin_node.messages import convert
from twin_node.scene import Float64, Rig

TF_STATIC = "/tf_static"
RIG_METADATA = "twin_node.rig"
"""Name of the metadata record."""

WORKSPACE, SIGMA_PREFIX, CLOCK_PREFIX = "workspace", "sigma_m.", "clock."


@dataclass(frozen=True)
class RecordedClock:
    """What makes a camera's stamps in the log the rig's time, as in `RigCamera`."""

    offset_ns: int
    rate_ppm: float
    reference_ns: int


@dataclass(frozen=True)
class RigRecord:
    """What CameraInfo and TF cannot say about a rig."""

    workspace: Float64 | None = None
    """[2, 3] lower and upper corner of the volume to model, metres."""
    sigmas_m: Mapping[str, float] = field(default_factory=dict)
    """Per camera that has one: error of its extrinsics at the working distance, 1 sigma, metres."""
    clocks: Mapping[str, RecordedClock] = field(default_factory=dict)
    """Per camera whose stamps in the log are not on the rig's clock."""


def write_rig(log: LogWriter, rig: Rig, stamp: int) -> None:
    """Writes `/tf_static` at a log time in ns and the rig's metadata record; CameraInfo goes with the images.

    Clock offsets and rates of `rig` are recorded for the reader to apply: leave them 0 where the log's stamps are on
    the rig's clock already.
    """
    log.write(TF_STATIC, convert.tf_static(rig, stamp), stamp)
    record = {f"{SIGMA_PREFIX}{camera.name}": repr(camera.sigma_m) for camera in rig.cameras if camera.sigma_m > 0}
    for camera in rig.cameras:
        if camera.time_offset_ns or camera.time_rate_ppm:
            clock = f"{camera.time_offset_ns} {camera.time_rate_ppm!r} {camera.time_reference_ns}"
            record[f"{CLOCK_PREFIX}{camera.name}"] = clock
    if rig.workspace is not None:
        record[WORKSPACE] = " ".join(repr(float(value)) for value in np.asarray(rig.workspace).flat)
    if record:
        log.add_metadata(RIG_METADATA, record)


def read_rig_record(log: LogReader) -> RigRecord:
    """The rig's metadata record of a log, empty where it has none. Raises `BagError` if it cannot be read."""
    record = log.metadata.get(RIG_METADATA, {})
    try:
        sigmas = {
            key.removeprefix(SIGMA_PREFIX): float(text) for key, text in record.items() if key.startswith(SIGMA_PREFIX)
        }
        clocks = {
            key.removeprefix(CLOCK_PREFIX): _clock(text) for key, text in record.items() if key.startswith(CLOCK_PREFIX)
        }
        text = record.get(WORKSPACE)
        workspace = None if text is None else np.array(text.split(), dtype=np.float64).reshape(2, 3)
    except ValueError as error:
        raise BagError(
            f"{log.path}: metadata record {RIG_METADATA} cannot be read ({error}); import it again"
        ) from None
    return RigRecord(workspace, sigmas, clocks)


def _clock(text: str) -> RecordedClock:
    offset, rate, reference = text.split()
    return RecordedClock(int(offset), float(rate), int(reference))
