"""Calibrated videos become a log with images, calibration and transforms."""

from __future__ import annotations

import heapq
import os
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.bag.frame_size import fit_to_frames
from twin_node.bag.log import BagError
from twin_node.bag.rig import write_rig
from twin_node.bag.writer import LogWriter
from twin_node.messages import convert
from twin_node.messages.stamps import NS_PER_S
from twin_node.scene import NAME_WANTED, Float64, Rig, RigCamera, UInt8, as_camera_name, is_camera_name

MOST_PERIODS, ROUNDING_S = 1.5, 0.002
"""Usual periods of a video's own times, and s, beyond which the time between two frames is no matter of rounding."""


@dataclass(frozen=True)
class VideoCamera:
    """A calibrated camera and its recording."""

    camera: RigCamera
    video: Path
    stamps: NDArray[np.int64] | None = None
    """[n] ns of the frames by the camera's own clock, strictly increasing; None: the rate says."""
    fps: float | None = None
    """Frames per second from time 0, where there are no stamps."""


@dataclass(frozen=True)
class VideoImport:
    """What an import did."""

    frames: tuple[int, ...]
    """Frames written per camera, in the order given."""
    warnings: tuple[str, ...]
    """One line for everything that was assumed or left out."""


def import_video(
    cameras: Sequence[VideoCamera],
    out: Path,
    progress: Callable[[int, int], None] | None = None,
    *,
    workspace: Float64 | None = None,
) -> VideoImport:
    """Streams videos in the order of their stamps into a log at `out` (see `LogWriter` for its forms).

    Per camera `/<name>/image_raw/compressed` (JPEG) and `/<name>/camera_info`; once `/tf_static` and, with the
    `workspace` [2, 3] in metres, the rig's metadata record. Stamps in the log are on the rig's clock
    (`RigCamera.rig_time`); where one lies before 0, as with a camera that began before the others, all are written so
    many whole seconds later that none does. `progress(done, total)` is called per frame; the total is what the
    containers claim.

    Raises `BagError` for a missing or unreadable video, a size that the calibration does not fit, fewer stamps than
    frames, and stamps that do not rise; nothing is left at `out` then.
    """
    names = [source.camera.name for source in cameras]
    if not cameras or len(set(names)) != len(names):
        raise BagError(f"{out}: expected at least one camera and every name once, found {', '.join(names) or 'none'}")
    clips = [_Clip(source) for source in cameras]
    total = sum(clip.claimed_frames for clip in clips)
    later = _put_later(clips)
    with LogWriter(out) as log:
        # The log's stamps are on the rig's clock: whoever reads it must not correct them once more.
        timed = (replace(clip.camera, time_offset_ns=0, time_rate_ppm=0.0, time_reference_ns=0) for clip in clips)
        rig = Rig(cameras=tuple(timed), workspace=workspace)
        write_rig(log, rig, min(clip.first_stamp for clip in clips))
        for done, frame in enumerate(heapq.merge(*clips, key=lambda frame: frame.stamp), start=1):
            _write_frame(log, frame)
            if progress is not None:
                progress(done, max(total, done))
        for clip in clips:
            clip.check_end()
    warnings = tuple(warning for clip in clips for warning in clip.warnings)
    return VideoImport(frames=tuple(clip.frames for clip in clips), warnings=(*later, *warnings))


def _put_later(clips: Sequence[_Clip]) -> tuple[str, ...]:
    """Shifts all clips alike where one begins before 0, which ROS has no stamps for; what a reader must know of it."""
    first = min(clips, key=lambda clip: clip.first_stamp)
    begins = first.first_stamp
    if begins >= 0:
        return ()
    seconds = -(begins // NS_PER_S)
    for clip in clips:
        clip.shift_ns = seconds * NS_PER_S
    return (
        f"camera {first.camera.name}: begins at {begins / NS_PER_S:g} s on the rig's clock, and a log at 0 s; all "
        f"cameras' stamps are written {seconds} s later",
    )


@dataclass(frozen=True)
class _Frame:
    camera: RigCamera
    stamp: int
    rgb: UInt8


def _write_frame(log: LogWriter, frame: _Frame) -> None:
    name, stamp = frame.camera.name, frame.stamp
    log.write(f"/{name}/camera_info", convert.camera_info(frame.camera, stamp), stamp)
    log.write(f"/{name}/image_raw/compressed", convert.compressed_image(name, stamp, frame.rgb), stamp)


class _Clip:
    """One video, opened: yields its frames with their corrected stamps."""

    def __init__(self, source: VideoCamera) -> None:
        name = source.camera.name
        if not is_camera_name(name):
            raise BagError(
                f"camera {name!r}: expected {NAME_WANTED}, as topics are named after it; rename it, for example to "
                f"{as_camera_name(name)}"
            )
        if not source.video.is_file():
            raise BagError(f"camera {name}: video {source.video} does not exist; correct the path in the rig file")
        if not os.access(source.video, os.R_OK):
            raise BagError(f"camera {name}: video {source.video} cannot be read; check its permissions")
        _check_times(source)
        self._source = source
        self._capture = cv2.VideoCapture(str(source.video))
        width = int(self._capture.get(cv2.CAP_PROP_FRAME_WIDTH))
        height = int(self._capture.get(cv2.CAP_PROP_FRAME_HEIGHT))
        if not self._capture.isOpened() or width <= 0 or height <= 0:
            raise BagError(f"camera {name}: {source.video} cannot be decoded as a video; convert it to H.264 in MP4")
        fitted = fit_to_frames(source.camera, width, height)
        self.camera = fitted.camera
        self.claimed_frames = max(0, int(self._capture.get(cv2.CAP_PROP_FRAME_COUNT)))
        self.warnings = [fitted.warning] if fitted.warning else []
        self.frames = 0
        self.shift_ns = 0
        """Put on every stamp."""
        self._file_times: list[float] = []
        """s, of the frames read, as the file has them."""

    @property
    def first_stamp(self) -> int:
        """Stamp of the first frame on the rig's clock, ns, shifted."""
        return self._stamp(0)

    def __iter__(self) -> Iterator[_Frame]:
        try:
            while True:
                ok, bgr = self._capture.read()
                if not ok:
                    return
                stamp = self._stamp(self.frames)
                self._note_time()
                self.frames += 1
                yield _Frame(self.camera, stamp, np.asarray(cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB), dtype=np.uint8))
        finally:
            self._capture.release()

    def check_end(self) -> None:
        """Compares what came with what was announced; raises `BagError` if nothing came."""
        name, video = self.camera.name, self._source.video
        if self.frames == 0:
            raise BagError(f"camera {name}: {video} holds no frame that can be decoded; record or convert it again")
        if (irregular := self._irregular()) is not None:
            self.warnings.append(irregular)
        if self.frames < self.claimed_frames:
            self.warnings.append(
                f"camera {name}: {video} ends after {self.frames} of the {self.claimed_frames} frames that it announces"
            )
        if self._source.stamps is not None and len(self._source.stamps) > self.frames:
            self.warnings.append(
                f"camera {name}: {len(self._source.stamps)} stamps for {self.frames} frames; the last are not used"
            )

    def _note_time(self) -> None:
        """Takes note of the time that the file has for the frame just read."""
        self._file_times.append(self._capture.get(cv2.CAP_PROP_POS_MSEC) / 1e3)

    def _irregular(self) -> str | None:
        """That the file's own times have no rate, where a rate is to stamp its frames, or that frames are lost.

        Frames' own stamps go with a varying rate; where there are some for frames that did not come, later ones are of
        others.
        """
        periods = np.diff(self._file_times)
        if len(periods) < 2 or periods.min() < 0:
            return None
        usual = float(np.median(periods))
        if periods.max() <= MOST_PERIODS * usual + ROUNDING_S:
            return None
        late, video, stamps = int(periods.argmax()) + 1, self._source.video, self._source.stamps
        if stamps is not None:
            if min(self.claimed_frames, len(stamps)) <= self.frames:
                return None
            return (
                f"camera {self._source.camera.name}: in {video} frame {late} comes {periods.max():.3f} s after the one "
                f"before, where {usual:.3f} s are usual: frames before it cannot be decoded, and those behind have the "
                "stamps of earlier ones; copy it again"
            )
        return (
            f"camera {self._source.camera.name}: in {video} frame {late} comes {periods.max():.3f} s after the one "
            f"before, where {usual:.3f} s are usual: it has no rate, and fps {self._source.fps:g} stamps it wrongly; "
            "give its own times as `stamps`: ffprobe -v error -select_streams v -show_entries frame=pts_time -of "
            f"csv=p=0 {video.name} > {video.stem}.txt"
        )

    def _stamp(self, index: int) -> int:
        source = self._source
        if source.stamps is None:
            own = round(index * NS_PER_S / (source.fps or 1.0))
        elif index < len(source.stamps):
            own = int(source.stamps[index])
        else:
            raise BagError(
                f"camera {source.camera.name}: frame {index} has no stamp ({len(source.stamps)} stamps in all); give "
                "one per frame"
            )
        return source.camera.rig_time(own) + self.shift_ns


def _check_times(source: VideoCamera) -> None:
    name = source.camera.name
    if source.stamps is None:
        if source.fps is None or not source.fps > 0 or not np.isfinite(source.fps):
            raise BagError(f"camera {name}: expected stamps or a positive frame rate, found {source.fps}; give either")
        return
    if len(source.stamps) == 0:
        raise BagError(f"camera {name}: the list of stamps is empty; give one per frame")
    falls = np.flatnonzero(np.diff(source.stamps) <= 0)
    if len(falls):
        index = int(falls[0]) + 1
        raise BagError(
            f"camera {name}: stamp {index} ({source.stamps[index]} ns) is not after stamp {index - 1} "
            f"({source.stamps[index - 1]} ns); sort the stamps"
        )
