"""How the twin is doing, and the clock: to messages and back."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from twin_node.messages.convert.camera import BASE_FRAME
from twin_node.messages.stamps import from_time, header, header_stamp, to_time
from twin_node.messages.types import Message, message_type
from twin_node.scene import Tier


@dataclass(frozen=True)
class Status:
    """What `/twin/status` says; a figure that is not known (yet) is NaN."""

    stamp: int
    """The newest evidence, ns."""
    tier_counts: tuple[int, ...]
    """Live Gaussians per `Tier`, in its order."""
    parameters: int
    """Learned parameters of the model."""
    sets: int
    """Image sets taken."""
    dropped: int
    """Image sets dropped because a newer one was there."""
    bytes_per_frame: float = math.nan
    """Mean size of what is published per image set, bytes."""
    latency_p50_ms: float = math.nan
    """From the evidence stamp to publication, ms."""
    latency_p95_ms: float = math.nan
    latency_p99_ms: float = math.nan
    coverage: float = math.nan
    """Share of what was seen to move that lay in the forecast made for that time 200 ms before, 0 to 1."""
    coverage_target: float = math.nan
    """Share that the bound aims at, 0 to 1."""
    psnr_db: float = math.nan
    """Newest clouds against the images, all pixels, dB; the live twin does not reckon it."""
    cameras: tuple[str, ...] = ()
    exposures: tuple[float, ...] = ()
    """Per camera how bright it shows the scene beside the light that the model was begun in."""
    warnings: tuple[str, ...] = ()
    """What a reader must know before trusting the twin."""


def status_to_message(status: Status) -> Message:
    """`twin_msgs/msg/TwinStatus` of a status."""
    counts = np.zeros(len(Tier), dtype=np.uint32)
    counts[: len(status.tier_counts)] = status.tier_counts
    return message_type("twin_msgs/msg/TwinStatus")(
        header=header(status.stamp, BASE_FRAME),
        tier_counts=counts,
        parameters=status.parameters,
        bytes_per_frame=float(status.bytes_per_frame),
        sets=status.sets,
        dropped=status.dropped,
        latency_p50_ms=float(status.latency_p50_ms),
        latency_p95_ms=float(status.latency_p95_ms),
        latency_p99_ms=float(status.latency_p99_ms),
        coverage=float(status.coverage),
        coverage_target=float(status.coverage_target),
        psnr_db=float(status.psnr_db),
        cameras=list(status.cameras),
        exposures=np.array(status.exposures, dtype=np.float64),
        warnings=list(status.warnings),
    )


def status_from_message(message: Message) -> Status:
    """Status from a `twin_msgs/msg/TwinStatus`."""
    return Status(
        stamp=header_stamp(message),
        tier_counts=tuple(int(count) for count in message.tier_counts),
        parameters=message.parameters,
        sets=message.sets,
        dropped=message.dropped,
        bytes_per_frame=message.bytes_per_frame,
        latency_p50_ms=message.latency_p50_ms,
        latency_p95_ms=message.latency_p95_ms,
        latency_p99_ms=message.latency_p99_ms,
        coverage=message.coverage,
        coverage_target=message.coverage_target,
        psnr_db=message.psnr_db,
        cameras=tuple(message.cameras),
        exposures=tuple(float(exposure) for exposure in message.exposures),
        warnings=tuple(message.warnings),
    )


def clock_to_message(stamp: int) -> Message:
    """`rosgraph_msgs/msg/Clock` of a time in ns."""
    return message_type("rosgraph_msgs/msg/Clock")(clock=to_time(stamp))


def clock_from_message(message: Message) -> int:
    """Time in ns of a `rosgraph_msgs/msg/Clock`."""
    return from_time(message.clock)


def line_to_log(stamp: int, node: str, line: str) -> Message:
    """`rcl_interfaces/msg/Log` of what a node tells its user, at a time in ns, for `/rosout`."""
    kind = message_type("rcl_interfaces/msg/Log")
    return kind(stamp=to_time(stamp), level=kind.INFO, name=node, msg=line, file="", function="", line=0)
