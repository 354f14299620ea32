"""By which clocks a log's cameras and joints are stamped, as the times tell at which they were recorded."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from statistics import median

from twin_node.bag import LogReader
from twin_node.messages import header_stamp
from twin_node.nodes.contents import content_of
from twin_node.nodes.player import Span
from twin_node.nodes.renaming import Renamed
from twin_node.nodes.topics import JOINT_STATES, CameraTopics
from twin_node.scene import Rig, RigCamera

OTHER_CLOCK_NS = 1_000_000_000
"""No image is recorded so long after its exposure, by one clock."""
ONE_CLOCK_NS = 100_000_000
"""By so much, cameras that are stamped by one clock may be recorded sooner and later; as a live synchroniser allows."""
A_MOMENT_NS = 500_000_000
"""In which a log's time goes on, if it is one."""
JOINTS_LOOKED_AT = 50
"""Messages with joints: of some devices on one topic, each with stamps of its own."""


def clocks_apart(log: LogReader, cameras: Sequence[CameraTopics], rig: Rig, span: Span) -> dict[str, int]:
    """Cameras whose stamps are by another clock than most others', and by how much they are ahead, ns; below 0: behind.

    Where no clock is that of most, it is that which the log was recorded by, or the nearest to it. A camera behind by
    less than `OTHER_CLOCK_NS` may send by a slower link, and one that is not as far off a moment later may have come
    later to a log whose times are none. `cameras`: as the log calls them.
    """
    first = _leads(log, cameras, rig, span)
    apart = _apart({name: lead for name, (lead, _) in first.items()})
    if not apart:
        return {}
    last_came = max(recorded for _, recorded in first.values())
    later = _leads(log, cameras, rig, Span(last_came + A_MOMENT_NS, span.stop_ns))
    still = _apart({name: lead for name, (lead, recorded) in later.items() if recorded > first[name][1]})
    return {name: ns for name, ns in apart.items() if abs(still.get(name, 0) - ns) <= ONE_CLOCK_NS // 2}


def _leads(log: LogReader, cameras: Sequence[CameraTopics], rig: Rig, span: Span) -> dict[str, tuple[int, int]]:
    """By camera, of its first image in a span: how far its stamp is ahead of when it was recorded, ns, and when that
    was, ns."""
    found = {}
    for camera in cameras:
        image = next(log.messages([camera.image], span.start_ns, span.stop_ns), None)
        if image is not None:
            stamp = _calibrated(camera, rig).rig_time(header_stamp(content_of(image, log)))
            found[camera.name] = (stamp - image.stamp, image.stamp)
    return found


def _apart(leads: Mapping[str, int]) -> dict[str, int]:
    """Which leads, ns, are another clock's than most others', and by how much they lie ahead of these."""
    if not leads:
        return {}
    clocks = [[lead for lead in leads.values() if abs(lead - own) <= ONE_CLOCK_NS] for own in leads.values()]
    _, _, theirs = max((len(clock), -min(map(abs, clock)), median(clock)) for clock in clocks)
    ahead = {name: round(lead - theirs) for name, lead in leads.items()}
    return {name: ns for name, ns in ahead.items() if ns > ONE_CLOCK_NS or ns < -OTHER_CLOCK_NS}


def apart_doubts(apart: Mapping[str, int]) -> Iterator[str]:
    """A line for each camera of `clocks_apart`."""
    for name, ahead_ns in apart.items():
        order = "after" if ahead_ns > 0 else "before"
        yield (
            f"camera '{name}': images are stamped {abs(ahead_ns) / 1e9:.3f} s {order} the others' that were recorded "
            "with them, by another clock, and the twin goes without them: let chrony or PTP keep the clocks together, "
            f"or give a rig file with a time_offset, {-ahead_ns / 1e9:+.3f} s or what 'twin_node calibrate time' finds"
        )


def by_one_clock(rig: Rig, apart: Mapping[str, int]) -> Rig:
    """The rig with cameras of `clocks_apart` put right: by some ten milliseconds, as much as delays differ."""
    offsets = [camera.time_offset_ns - apart.get(camera.name, 0) for camera in rig.cameras]
    cameras = (replace(camera, time_offset_ns=ns) for camera, ns in zip(rig.cameras, offsets, strict=True))
    return replace(rig, cameras=tuple(cameras))


def clock_doubts(log: LogReader, camera: CameraTopics, rig: Rig) -> Iterator[str]:
    """A line where images were recorded long after their stamps; `camera`: one of the log's, as the log calls it."""
    old_ns = _image_delay(log, camera, rig)
    if old_ns is not None and old_ns > OTHER_CLOCK_NS:
        yield (
            f"images are stamped {old_ns / 1e9:.1f} s before they were recorded, by another clock: no arm may go by "
            "what is so old, and each decision is to stand; record by the clock of the stamps (a simulator's: ros2 bag "
            "record --use-sim-time)"
        )


def joint_clock_doubts(log: LogReader, names: Renamed, camera: CameraTopics, rig: Rig) -> Iterator[str]:
    """A line where joints are stamped by another clock than images, so that they belong to none; `camera`: as above."""
    image_delay = _image_delay(log, camera, rig)
    if image_delay is None:
        return
    entries = itertools.islice(log.messages([names.original(JOINT_STATES)]), JOINTS_LOOKED_AT)
    apart_ns = [entry.stamp - header_stamp(content_of(entry, log)) - image_delay for entry in entries]
    nearest_ns = min(apart_ns, key=abs, default=0)
    if abs(nearest_ns) > OTHER_CLOCK_NS:
        yield (
            f"joints on {names.original(JOINT_STATES)} are stamped {abs(nearest_ns) / 1e9:.1f} s "
            f"{'before' if nearest_ns > 0 else 'after'} images that were recorded with them, by another clock: they "
            "are those of no image, and the arm in the images counts as something that moves; let their publisher fill "
            "in header.stamp, by the clock of the cameras"
        )


def _image_delay(log: LogReader, camera: CameraTopics, rig: Rig) -> int | None:
    """From the first image's stamp on the rig's clock until it was recorded, ns; None without an image."""
    first = next(log.messages([camera.image]), None)
    return (
        None if first is None else first.stamp - _calibrated(camera, rig).rig_time(header_stamp(content_of(first, log)))
    )


def _calibrated(camera: CameraTopics, rig: Rig) -> RigCamera:
    return next(one for one in rig.cameras if one.name == camera.name)
