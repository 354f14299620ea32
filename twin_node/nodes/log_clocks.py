"""By which clocks a log's cameras and joints are stamped, as the times tell at which they were recorded."""

from __future__ import annotations

import itertools
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from statistics import median

from twin_node.bag import LogReader
from twin_node.messages import header_stamp
from twin_node.nodes.contents import content_of
from twin_node.nodes.player import Span
from twin_node.nodes.topics import CameraTopics
from twin_node.scene import Rig

OTHER_CLOCK_NS = 1_000_000_000
"""No image is recorded so long after its exposure, by one clock."""
ONE_CLOCK_NS = 100_000_000
"""By so much, cameras that are stamped by one clock may be recorded sooner and later; as a live synchroniser allows."""
A_MOMENT_NS = 500_000_000
"""How much later the cameras are looked at again, ns: times of recording that have not gone on by then tell nothing."""
JOINTS_LOOKED_AT = 50
"""Messages that tell of joints: of some devices on one topic, each with stamps, and at a rate, of its own."""


class LogClocks:
    """What speaks of the clocks of a log's cameras, a line each where it is not as it should be."""

    def __init__(self, log: LogReader, cameras: Sequence[CameraTopics], rig: Rig, span: Span) -> None:
        """`cameras`: the rig's, as the log calls them; `span`: of the log, that is looked at."""
        self._log = log
        self._rig_cameras = {camera.name: camera for camera in rig.cameras}
        self._unstamped = [camera.name for camera in cameras if self._is_unstamped(camera)]
        stamped = [camera for camera in cameras if camera.name not in self._unstamped]
        self.apart: Mapping[str, int] = self._found_apart(stamped, span)
        """Cameras whose stamps are by another clock than most others', and how far they are ahead, ns; below 0: behind.

        Where no clock is that of most, it is that which the log was recorded by, or the nearest to it. A camera behind
        by less than `OTHER_CLOCK_NS` may send by a slower link.
        """
        self._delay_ns = self._delay([camera for camera in stamped if camera.name not in self.apart])

    @property
    def strangers(self) -> Collection[str]:
        """Names of cameras whose images can be in no set of the others'."""
        return {*self._unstamped, *self.apart}

    def by_one_clock(self, rig: Rig) -> Rig:
        """The rig with cameras that are `apart` put right, to some ten milliseconds: as much as delays differ."""
        offsets = [camera.time_offset_ns - self.apart.get(camera.name, 0) for camera in rig.cameras]
        cameras = (replace(camera, time_offset_ns=ns) for camera, ns in zip(rig.cameras, offsets, strict=True))
        return replace(rig, cameras=tuple(cameras))

    def camera_doubts(self) -> Iterator[str]:
        """A line for each of the strangers."""
        for name in self._unstamped:
            yield (
                f"camera '{name}': images have no time, header.stamp is 0, and the twin goes without them: let the "
                "driver fill it in by the clock of the other cameras and of the arm"
            )
        for name, ahead_ns in self.apart.items():
            seconds, order = abs(ahead_ns) / 1e9, "after" if ahead_ns > 0 else "before"
            yield (
                f"camera '{name}': images are stamped {seconds:.3f} s {order} the others' that were recorded with "
                "them, by another clock, and the twin goes without them: let chrony or PTP keep the clocks together or "
                f"give a rig file with a time_offset, {-ahead_ns / 1e9:+.3f} s or what 'twin_node calibrate time' finds"
            )

    def image_doubts(self) -> Iterator[str]:
        """A line where images were recorded long after their stamps."""
        if self._delay_ns is not None and self._delay_ns > OTHER_CLOCK_NS:
            yield (
                f"images are stamped {self._delay_ns / 1e9:.1f} s before they were recorded, by another clock: no arm "
                "may go by what is so old, and each decision is to stand; record by the clock of the stamps (a "
                "simulator's: ros2 bag record --use-sim-time)"
            )

    def joint_doubts(self, joints: str) -> Iterator[str]:
        """A line where joints are stamped by another clock than images, so that they belong to none.

        `joints`: their topic, as the log calls it.
        """
        if self._delay_ns is None:
            return
        entries = itertools.islice(self._log.messages([joints]), JOINTS_LOOKED_AT)
        apart_ns = [entry.stamp - header_stamp(content_of(entry, self._log)) - self._delay_ns for entry in entries]
        nearest_ns = min(apart_ns, key=abs, default=0)
        if abs(nearest_ns) > OTHER_CLOCK_NS:
            seconds, order = abs(nearest_ns) / 1e9, "before" if nearest_ns > 0 else "after"
            yield (
                f"joints on {joints} are stamped {seconds:.1f} s {order} images that were recorded with them, by "
                "another clock: they are those of no image, and the arm in the images counts as something that moves; "
                "let their publisher fill in header.stamp, by the clock of the cameras"
            )

    def _is_unstamped(self, camera: CameraTopics) -> bool:
        """Whether stamps are 0 and stay so, as where a driver leaves them out; a simulator's begin there."""
        images = itertools.islice(self._log.messages([camera.image]), 2)
        return [header_stamp(content_of(image, self._log)) for image in images] == [0, 0]

    def _found_apart(self, cameras: Sequence[CameraTopics], span: Span) -> dict[str, int]:
        """Cameras that are as far off a moment later, too: where times of recording do not go on, a camera that was
        started later seems to be ahead."""
        first = self._leads(cameras, span)
        apart = _apart({name: lead for name, (lead, _) in first.items()})
        if not apart:
            return {}
        last_came = max(recorded for _, recorded in first.values())
        later = self._leads(cameras, Span(last_came + A_MOMENT_NS, span.stop_ns))
        still = _apart({name: lead for name, (lead, recorded) in later.items() if recorded > first[name][1]})
        return {name: ns for name, ns in apart.items() if abs(still.get(name, 0) - ns) <= ONE_CLOCK_NS // 2}

    def _leads(self, cameras: Sequence[CameraTopics], span: Span) -> dict[str, tuple[int, int]]:
        """By camera, of its first image in a span: how far its stamp is ahead of when it was recorded, ns, and when
        that was, ns."""
        found = {}
        for camera in cameras:
            image = next(self._log.messages([camera.image], span.start_ns, span.stop_ns), None)
            if image is not None:
                stamp = self._rig_cameras[camera.name].rig_time(header_stamp(content_of(image, self._log)))
                found[camera.name] = (stamp - image.stamp, image.stamp)
        return found

    def _delay(self, cameras: Sequence[CameraTopics]) -> int | None:
        """From the first image's stamp on the rig's clock until it was recorded, ns; None without an image."""
        whole = Span(self._log.start_ns, self._log.end_ns + 1)
        return next((-lead for lead, _ in self._leads(cameras[:1], whole).values()), None)


def _apart(leads: Mapping[str, int]) -> dict[str, int]:
    """Which leads, ns, are another clock's than most others', and by how much they lie ahead of these."""
    if not leads:
        return {}
    clocks = [[lead for lead in leads.values() if abs(lead - own) <= ONE_CLOCK_NS] for own in leads.values()]
    _, _, theirs = max((len(clock), -min(map(abs, clock)), median(clock)) for clock in clocks)
    ahead = {name: round(lead - theirs) for name, lead in leads.items()}
    return {name: ns for name, ns in ahead.items() if ns > ONE_CLOCK_NS or ns < -OTHER_CLOCK_NS}
