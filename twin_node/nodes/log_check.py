"""Looks a log over before the twin is run on it: gaps, jitter, skew, images, calibration, units."""

from __future__ import annotations

import warnings
from array import array
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin_node.arm.path import sample_path
from twin_node.bag import LogMessage, LogReader
from twin_node.bag.log_times import NO_STOP
from twin_node.errors import TwinError, TwinWarning, several
from twin_node.messages import convert, from_time
from twin_node.messages.stamps import NS_PER_S
from twin_node.nodes.calibration import check_depth, rig_for
from twin_node.nodes.clock_steps import clock_step
from twin_node.nodes.image_check import EveryImage, depth_faults, image_faults
from twin_node.nodes.joint_units import angle_fault, ranges_told
from twin_node.nodes.log_cameras import cameras_of
from twin_node.nodes.log_doubts import base_doubts, joint_doubts, rig_doubts
from twin_node.nodes.log_source import LogSession, LogSource
from twin_node.nodes.moved_frames import moved_frames
from twin_node.nodes.renaming import Renamed, check_types, renamed
from twin_node.nodes.stream_statistics import StreamStatistics, faults_of, statistics_of
from twin_node.nodes.synchronizer import SynchronizerParameters
from twin_node.nodes.topics import (
    CAMERA_INFO,
    IMAGE_TYPES,
    JOINT_STATE,
    RECORDED,
    REGULAR_TYPES,
    TF_STATIC,
    TRAJECTORY,
    CameraTopics,
    GraphError,
    has_images,
    is_depth,
    kind_of_own,
)
from twin_node.scene import Float64

DELAY_NS = 1_000_000_000
"""A header stamp further than this from the time of recording was made by another clock."""
SAMPLES = 5
"""Images of a topic whose content is looked at, spread over the log."""
SKEW_SHARE = 0.25
"""Cameras further apart than this share of a period, of which a half is the most, do not belong to one exposure."""
SLOWER = 0.9
"""A camera whose rate is below this share of the fastest one's sends more slowly."""


@dataclass(frozen=True)
class TopicCheck:
    """What was found of one topic."""

    name: str
    msgtype: str
    statistics: StreamStatistics
    """Of joints that several devices tell on one topic, the count is of all, the rest of whose come most often."""
    faults: tuple[str, ...] = ()


@dataclass(frozen=True)
class LogCheck:
    """What was found of a log."""

    topics: tuple[TopicCheck, ...]
    faults: tuple[str, ...]
    """Of the log as a whole: damage, cameras, their images, calibration, skew."""

    @property
    def is_sound(self) -> bool:
        """Whether nothing was found."""
        return not self.faults and not any(topic.faults for topic in self.topics)


@dataclass
class _Stream:
    """What one device says on a topic, in few bytes a message: an arm tells of itself 500 times a second."""

    stamps: array[int] = field(default_factory=lambda: array("q"))
    """ns, as those in which it was recorded after them."""
    delays: array[int] = field(default_factory=lambda: array("q"))
    farthest: Float64 | None = None
    """[J] how far each of its joints went, rad, without sign; None of what tells no joint."""


@dataclass
class _Seen:
    """One topic while the log is read."""

    streams: dict[tuple[str, ...], _Stream] = field(default_factory=dict)
    """By the names of the joints that they tell: an arm and its gripper share a topic, each at a rate of its own.

    Of other messages there is one, without names.
    """
    count: int = 0
    contents: list[Any] = field(default_factory=list)
    calibrations: dict[tuple[object, ...], int] = field(default_factory=dict)
    """By what a camera's CameraInfo say of its lens: when that was first said, ns."""
    uncarried: int = 0
    """Stamps with whole seconds among their nanoseconds: no two programs need to take them for the same time."""
    wild: int = 0
    """JointStates with positions none of which is a number, or one of which is infinite."""
    uneven: int = 0
    """JointStates with other numbers of positions or velocities than of names, which nobody can tell apart."""

    @property
    def busiest(self) -> _Stream:
        """The stream with the most messages."""
        return max(self.streams.values(), key=lambda stream: len(stream.stamps), default=_Stream())


def check_log(
    log: LogReader,
    every_image: bool = False,
    progress: Callable[[Iterable[LogMessage]], Iterable[LogMessage]] = iter,
) -> LogCheck:
    """Reads the whole log once, which `progress` may wrap; `every_image`: all are decoded, not `SAMPLES` of a topic."""
    seen: dict[str, _Seen] = {topic.name: _Seen() for topic in log.topics}
    every = {topic.name: max(1, topic.count // SAMPLES) for topic in log.topics}
    unreadable: dict[str, str] = {}
    ranges = ranges_told(log)
    images = EveryImage()
    topics = renamed(log)
    of_paths = topics.original(TRAJECTORY)
    for message in progress(log.messages()):
        try:
            _look_at(message, seen[message.topic], every[message.topic])
            if message.topic == of_paths and message.msgtype == kind_of_own(TRAJECTORY).msgtype:
                _check_path(message)
            if every_image and message.msgtype in IMAGE_TYPES:
                images.look(message.topic, message.message)
        except TwinError as error:
            unreadable.setdefault(message.topic, str(error))
    checks = []
    for topic in log.topics:
        found = seen[topic.name]
        statistics = replace(statistics_of(found.busiest.stamps), count=found.count)
        faults = [unreadable[topic.name]] if topic.name in unreadable else []
        for names, stream in found.streams.items():
            whose = f"{', '.join(names)}: " if len(found.streams) > 1 else ""
            is_regular = topic.msgtype in REGULAR_TYPES
            unit = None if stream.farthest is None or found.wild else angle_fault(names, stream.farthest, ranges)
            times = [] if found.uncarried else _time_faults(stream, is_regular, log.start_ns)
            twice = sorted({name for name in names if names.count(name) > 1})
            named = f"messages name {', '.join(twice)} more than once" if twice else None
            in_all = [*times, *filter(None, [unit, named])]
            faults += [f"{whose}{fault}" for fault in in_all]
        faults += [*_stamp_faults(found), *images.faults(topic.name)]
        faults += _unit_faults(topic.name, topic.msgtype, found, images)
        faults += _calibration_faults(found, log.start_ns)
        checks.append(TopicCheck(topic.name, topic.msgtype, statistics, tuple(faults)))
    whole = [log.damage] if log.damage else []
    whole += [f"not read: {line}" for line in log.left_out]
    try:
        check_types(log, topics)
    except GraphError as error:
        whole.append(str(error))
    else:
        whole += [*_camera_faults(log, topics, seen, images), *moved_frames(log, topics.original(TF_STATIC))]
    return LogCheck(tuple(checks), tuple(whole))


def _stamp_faults(seen: _Seen) -> list[str]:
    """What speaks against the stamps of a topic, each by itself."""
    if not seen.uncarried:
        return []
    return [
        f"{seen.uncarried} of {seen.count} stamps have a nanosec of 1e9 or more: whoever makes them does not carry it "
        "over to sec"
    ]


def _time_faults(stream: _Stream, is_regular: bool, start: int) -> list[str]:
    """What speaks against the times of a stream, which may come at a rate; `start`: of the log, ns."""
    faults = list(faults_of(statistics_of(stream.stamps))) if is_regular else []
    delay = float(np.median(stream.delays)) if stream.delays else 0.0
    if abs(delay) > DELAY_NS:
        order = "before" if delay > 0 else "after"
        faults.append(f"stamped {abs(delay) / 1e9:.1f} s {order} the time of recording: another clock")
    step = clock_step(stream.stamps, stream.delays) if is_regular else None
    return faults if step is None else [*faults, step.told(start)]


def _look_at(message: LogMessage, seen: _Seen, every: int) -> None:
    """Takes note of a message's times, and of every so many's content."""
    is_stamped = message.msgtype in REGULAR_TYPES or message.msgtype == CAMERA_INFO
    content: Any = message.message if is_stamped else None
    is_of_joints = message.msgtype == JOINT_STATE
    names = tuple(content.name) if is_of_joints else ()
    stream = seen.streams.setdefault(names, _Stream())
    if is_of_joints:
        _look_at_joints(content, seen, stream)
    elif is_stamped and seen.count % every == 0:
        seen.contents.append(content)
    if message.msgtype == CAMERA_INFO:
        seen.calibrations.setdefault(_lens_told(content), message.stamp)
    stamp = from_time(content.header.stamp) if is_stamped else message.stamp
    stream.stamps.append(stamp)
    if is_stamped:
        seen.uncarried += int(content.header.stamp.nanosec >= NS_PER_S)
        stream.delays.append(min(message.stamp - stamp, NO_STOP - 1))
    seen.count += 1


def _check_path(message: LogMessage) -> None:
    """Raises `TwinError` for a trajectory that nobody can go along; one without points holds the arm where it is."""
    content: Any = message.message
    if content.points:
        path = convert.joint_path_from_message(content, message.stamp)
        sample_path(path, path.stamps[:1])


def _look_at_joints(content: Any, seen: _Seen, stream: _Stream) -> None:
    """Takes note of where a JointState has its joints."""
    positions = np.abs(content.position)
    seen.wild += bool(np.isinf(positions).any() or (len(positions) and np.isnan(positions).all()))
    told = (len(content.name), len(content.velocity) or len(content.name))
    seen.uneven += bool(len(positions)) and told != (len(positions), len(positions))
    if len(positions) == len(content.name):
        before = np.zeros(len(positions)) if stream.farthest is None else stream.farthest
        stream.farthest = np.fmax(before, positions)


def _lens_told(info: Any) -> tuple[object, ...]:
    """What a CameraInfo says but its time, to be compared."""
    matrices = (np.asarray(numbers, np.float64).tobytes() for numbers in (info.d, info.k, info.r, info.p))
    return (info.header.frame_id, info.height, info.width, info.distortion_model, *matrices)


def _calibration_faults(seen: _Seen, start: int) -> list[str]:
    """What speaks against a CameraInfo that says something else in the middle of a log; `start`: of the log, ns."""
    if len(seen.calibrations) < 2:
        return []
    changed = list(seen.calibrations.values())[1]
    return [
        f"calibration changes {(changed - start) / 1e9:.1f} s after the start, and a twin takes the first one "
        "throughout; use what lies before or after it, or give a rig file"
    ]


def _unit_faults(topic: str, msgtype: str, seen: _Seen, images: EveryImage) -> list[str]:
    """What speaks against the units of a topic's messages."""
    if msgtype == JOINT_STATE:
        wild = [f"{several(seen.wild, 'message')} with positions that are not finite"] if seen.wild else []
        uneven = f"{several(seen.uneven, 'message')} with other numbers of positions or velocities than of names"
        return [*wild, *([uneven] if seen.uneven else [])]
    if msgtype in IMAGE_TYPES and is_depth(topic):
        return depth_faults(topic, seen.contents, images)
    return []


def _camera_faults(log: LogReader, names: Renamed, seen: Mapping[str, _Seen], images: EveryImage) -> list[str]:
    if not has_images(names.spoken) and any(topic in RECORDED for topic in names.spoken):
        return []  # what a twin has said; the images that it was made from are in another log
    try:
        in_log = cameras_of(log, names)
    except GraphError as error:
        return [str(error)]
    cameras = [names.original_camera(camera) for camera in in_log.found]
    stamps = {camera.image: seen[camera.image].busiest.stamps for camera in cameras}
    contents = {camera.image: seen[camera.image].contents for camera in cameras}
    faults = [*in_log.unused, *joint_doubts(names)]
    try:
        check_depth(log, cameras, names.original(TF_STATIC))
    except GraphError as error:
        faults.append(str(error))
    try:
        found = rig_for(log, cameras, None, names.original(TF_STATIC))
    except TwinError as error:
        of_images = image_faults(cameras, contents, {}, images)
        return [*of_images, *_skew_faults(_timed(cameras, seen), stamps), *faults, str(error)]
    known = {camera.name: camera for camera in found.rig.cameras}
    cameras = [camera for camera in cameras if camera.name in known]
    timed = _timed(cameras, seen)
    by_rig = {c.image: [known[c.name].rig_time(stamp) for stamp in stamps[c.image]] for c in timed}
    faults = [
        *image_faults(cameras, contents, known, images),
        *_rate_faults(timed, by_rig),
        *_skew_faults(timed, by_rig),
        *_depth_skews(timed, seen),
        *faults,
    ]
    doubts = (*found.left_out, *rig_doubts(cameras, found.rig), *base_doubts(log, names))
    return [*doubts, *(faults or _first_set_faults(log))]


def _timed(cameras: Sequence[CameraTopics], seen: Mapping[str, _Seen]) -> list[CameraTopics]:
    """Cameras whose stamps are such as say when their images and depth were taken."""
    return [c for c in cameras if not any(seen[topic].uncarried for topic in (c.image, c.depth) if topic)]


def _first_set_faults(log: LogReader) -> list[str]:
    """What keeps a twin from beginning where cameras, images and calibration are sound, each by itself."""
    try:
        with warnings.catch_warnings(), LogSession(log.path) as session:
            warnings.simplefilter("ignore", TwinWarning)  # what the check tells by itself
            source = LogSource(session, SynchronizerParameters())
            _ = source.workspace  # a twin needs one, and cameras may see none together
            first = next(iter(source), None)
    except TwinError as error:
        return [str(error)]
    if first is not None:
        return []
    names = ", ".join(camera.name for camera in session.rig.cameras)
    return [f"no set of images of {names}: their stamps lie too far apart, or too few were recorded"]


def _depth_skews(cameras: Sequence[CameraTopics], seen: Mapping[str, _Seen]) -> Iterator[str]:
    """Cameras whose depth is stamped so far from their images that it is taken for that of no image."""
    tolerance_ns = SynchronizerParameters().depth_tolerance_ms * 1e6
    for camera in cameras:
        of_depth = seen[camera.depth].busiest.stamps if camera.depth else []
        images, depths = (np.array(stamps, np.int64) for stamps in (seen[camera.image].busiest.stamps, of_depth))
        if len(images) < 2 or len(depths) < 2:
            continue
        skew = float(np.median(_to_nearest(depths, images)))
        if skew > tolerance_ns:
            yield (
                f"camera '{camera.name}': {camera.depth} is stamped {skew / 1e6:.1f} ms from the images, more than "
                f"{tolerance_ns / 1e6:g}, and would be left out; let the driver synchronise them, or raise "
                "synchronizer.depth_tolerance_ms"
            )


def _to_nearest(stamps: NDArray[np.int64], others: NDArray[np.int64]) -> NDArray[np.int64]:
    """How far [N] stamps [N] are from the nearest of two or more others, ns."""
    right = np.clip(np.searchsorted(others, stamps), 1, len(others) - 1)
    gaps: NDArray[np.int64] = np.minimum(np.abs(others[right] - stamps), np.abs(others[right - 1] - stamps))
    return gaps


def _rate_faults(cameras: Sequence[CameraTopics], stamps: Mapping[str, Sequence[int]]) -> Iterator[str]:
    """Cameras that send more slowly than the fastest one; `stamps` by topic, ns."""
    rates = {camera.name: statistics_of(stamps[camera.image]).rate_hz for camera in cameras}
    fastest = max(rates, key=lambda name: rates[name] if np.isfinite(rates[name]) else 0.0, default="")
    for name, rate in rates.items():
        if rate < SLOWER * rates[fastest]:
            yield (
                f"camera '{name}': {rate:.1f} images per second beside {rates[fastest]:.1f} of '{fastest}': sets come "
                "as rarely, or without it; let all cameras send at one rate"
            )


def _skew_faults(cameras: Sequence[CameraTopics], stamps: Mapping[str, Sequence[int]]) -> list[str]:
    """Cameras whose images lie too far from those of the first one while both send; `stamps` by topic, ns.

    Of two rates it counts how far the images of the slower camera lie from those of the other.
    """
    faults = []
    for camera in cameras[1:]:
        first = np.array(stamps[cameras[0].image], dtype=np.int64)
        own = np.array(stamps[camera.image], dtype=np.int64)
        if len(first) < 2 or len(own) < 2:
            continue
        period = min(float(np.median(np.diff(first))), float(np.median(np.diff(own))))
        skews = [skew for skew in (_skew(first, own, period), _skew(own, first, period)) if skew is not None]
        if skews and min(skews) > SKEW_SHARE * period:
            faults.append(
                f"camera '{camera.name}': images lie {min(skews) / 1e6:.1f} ms from those of "
                f"'{cameras[0].name}'; trigger them together, or calibrate their clocks ('twin_node calibrate time')"
            )
    return faults


def _skew(stamps: NDArray[np.int64], others: NDArray[np.int64], period: float) -> float | None:
    """How far stamps [N] lie from the nearest of others [M], both ns, while these come; None: none do by then."""
    together = stamps[(stamps > others[0] - period) & (stamps < others[-1] + period)]
    return float(np.median(_to_nearest(together, others))) if len(together) else None
