"""What the sets of a run held of each camera, and what they had to do without."""

from __future__ import annotations

from collections import Counter
from collections.abc import Collection, Mapping, Sequence
from typing import NamedTuple

from twin_node.nodes.topics import CameraTopics
from twin_node.scene import FrameSet

LEAST_SHARE = 0.5
"""Share of all sets in which a camera is expected to have an image, and of its images with depth where it measures."""
STOPPED_S, STOPPED_SETS = 1.0, 5
"""A camera of which the last sets have nothing has stopped, where these are so long, s, and so many."""


class SetContents:
    """Counts, set by set."""

    def __init__(self) -> None:
        self.sets = 0
        self.images: Counter[str] = Counter()
        """By camera."""
        self.depths: Counter[str] = Counter()
        """The same of images with depth."""
        self._last: dict[str, tuple[int, int]] = {}
        """By camera, stamp (ns) and number of the last set with an image."""
        self._stamp = 0
        """Of the last set, ns."""
        self._came: tuple[int, int] | None = None
        """When the first and the last set came, ns of the log's time."""

    def add(self, frames: FrameSet, now: int) -> None:
        """Takes note of a set that comes at a time of the log, ns."""
        self.sets += 1
        self._came = (now if self._came is None else self._came[0], now)
        self.images.update(view.camera.name for view in frames.views)
        self.depths.update(view.camera.name for view in frames.views if view.depth is not None)
        self._stamp = frames.stamp
        self._last |= {view.camera.name: (frames.stamp, self.sets) for view in frames.views}

    def lacking(
        self,
        names: Collection[str],
        cameras: Sequence[CameraTopics],
        rate: float = 1.0,
        damaged: Mapping[str, int] | None = None,
    ) -> tuple[str, ...]:
        """A line for each camera of the names that most sets had to do without, or the last ones, or its images without
        their depth.

        `rate`: speed of the clock by that of the recording; where it is higher, images may come too late by it.
        `damaged`: how many of a camera's images were left out as damaged, which is told elsewhere: sets that had to do
        without these say nothing of its stamps.
        """
        left_out = damaged or {}
        hurried = f"; or {rate:g} times the recording's speed is too fast here: lower --rate" if rate > 1 else ""
        lines = [
            f"camera {name}: in only {self.images[name]} of {self.sets} sets: its images' stamps lie too far from the "
            f"others', or it sends more slowly; see their times with 'twin_node check'{hurried}"
            for name in names
            if self.images[name] + left_out.get(name, 0) < LEAST_SHARE * self.sets
        ]
        lines += [
            f"camera {name}: in none of the last {stopped.sets} sets, {stopped.seconds:.1f} s: it stopped, or its "
            f"clock was set; see its times with 'twin_node check'{hurried}"
            for name in names
            if (stopped := self._stopped(name)) is not None and left_out.get(name, 0) < stopped.sets
        ]
        for camera in cameras:
            images, depths = self.images[camera.name], self.depths[camera.name]
            if camera.name in names and camera.depth and depths < LEAST_SHARE * images:
                lines.append(
                    f"camera {camera.name}: depth with only {depths} of its {images} images: stamps of {camera.depth} "
                    "lie too far from theirs (synchronizer.depth_tolerance_ms), or fewer came; see their times with "
                    f"'twin_node check'{hurried}"
                )
        return tuple(lines)

    def ended_before(self, stop_ns: int) -> str | None:
        """A line where no set has come for long before the end of what was read, ns of the log's time."""
        first, last = self._came or (stop_ns, stop_ns)
        usual_s = (last - first) * 1e-9 / max(self.sets - 1, 1)
        silent_s = (stop_ns - last) * 1e-9
        if silent_s <= max(STOPPED_S, STOPPED_SETS * usual_s):
            return None
        return (
            f"no set of images in the last {silent_s:.1f} s of the log, after {self.sets}: all cameras stopped, or "
            "their clocks were set; see their times with 'twin_node check'"
        )

    def _stopped(self, name: str) -> _Stopped | None:
        """What a camera that most sets have has not been in at the end; None: it has."""
        stamp, number = self._last.get(name, (self._stamp, self.sets))
        stopped = _Stopped(self.sets - number, (self._stamp - stamp) * 1e-9)
        is_told = self.images[name] < LEAST_SHARE * self.sets
        return None if is_told or stopped.seconds <= STOPPED_S or stopped.sets < STOPPED_SETS else stopped


class _Stopped(NamedTuple):
    """The end of a run without a camera."""

    sets: int
    seconds: float
