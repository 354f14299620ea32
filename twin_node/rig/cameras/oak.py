"""Luxonis OAK cameras through depthai 3: one or several devices, depth aligned with colour, lost ones found again.

depthai is imported when a source is made. A device that is unplugged, or not there yet, is looked for once a second
while the others go on.
"""

from __future__ import annotations

import contextlib
import threading
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import Any, Protocol

import cv2
import numpy as np

from twin_node.ranges import NOT_NEGATIVE, POSITIVE, WIDTHS_PX, check_ranges
from twin_node.rig.cameras.image_source import WAIT_S, CameraImage
from twin_node.rig.cameras.oak_lens import DepthBender, FactoryCalibration, factory_calibration
from twin_node.rig.cameras.stamps import CaptureStamps
from twin_node.rig.cameras.threaded_source import QUEUED_PER_CAMERA, RETRY_S, ThreadedSource
from twin_node.rig.errors import RigError
from twin_node.scene import Float32

STALLED_S = 10.0
"""A device that is there, and sends no image for so long, is opened anew, s: what its pipeline or its cable has lost
does not come back by itself. One that waits for another's trigger is none the worse for it."""
PAIR_TOLERANCE_NS = 10_000_000
"""A depth image belongs to the colour image of the same exposure: colour and mono mid-exposures differ by less."""
SYNC_MODES = ("none", "auto", "output", "input", "ptp")
"""How a device's shutters keep time with others' (FSYNC cable, or PTP over Ethernet)."""


@dataclass(frozen=True)
class OakCamera:
    """One device and how it is set."""

    name: str
    device: str = ""
    """Its identifier or IP address; empty, of one camera of a rig: the first device that no other camera has."""
    width: int = 640
    height: int = 480
    fps: float = 30.0
    depth: bool = True
    """Measure depth by stereo, aligned with the colour image."""
    depth_preset: str = "ROBOTICS"
    """A member of depthai's `StereoDepth.PresetMode`."""
    exposure_us: int = 0
    """Fixed exposure, microseconds; 0: automatic, whose changing length moves mid-exposure."""
    iso: int = 400
    """Sensitivity that goes with a fixed exposure."""
    sync: str = "none"
    """One of `SYNC_MODES`."""

    def __post_init__(self) -> None:
        """Raises `RigError` for a mode that is none, and numbers that no device can be set to."""
        size, where = WIDTHS_PX, f"camera {self.name}: "
        check_ranges(
            self, RigError, where, width=size, height=size, fps=POSITIVE, exposure_us=NOT_NEGATIVE, iso=POSITIVE
        )
        if self.sync not in SYNC_MODES:
            raise RigError(f"camera {self.name}: sync: expected one of {', '.join(SYNC_MODES)}, found '{self.sync}'")


class OakStreams(Protocol):
    """A device's running pipeline, as far as the driver needs it."""

    @property
    def colour(self) -> Any:
        """depthai queue of colour `ImgFrame`s."""

    @property
    def depth(self) -> Any | None:
        """depthai queue of depth `ImgFrame`s (uint16, mm), aligned with colour without its distortion; None: none."""

    @property
    def calibration(self) -> FactoryCalibration | None:
        """From the device; None where it has none."""

    def close(self) -> None:
        """Ends the pipeline and lets go of the device."""


class OakSource(ThreadedSource[OakCamera]):
    """A thread per device."""

    def __init__(
        self, cameras: Sequence[OakCamera], connect: Callable[[OakCamera], OakStreams | None] | None = None
    ) -> None:
        """`connect`: opens a camera's device, None where it is not there; the real ones by default.

        Raises `RigError` for no cameras, equal names or devices, several without a device, an unknown preset, and where
        depthai is not installed.
        """
        super().__init__(cameras)
        for first, second in combinations(cameras, 2):
            if first.device and first.device == second.device:
                raise RigError(
                    f"cameras {first.name} and {second.name}: expected a device each, found {first.device!r} for both; "
                    "`twin_node doctor --devices` lists them"
                )
        self._dai = _depthai()
        presets = self._dai.node.StereoDepth.PresetMode.__members__
        for camera in cameras:
            if camera.depth_preset not in presets:
                raise RigError(
                    f"camera {camera.name}: depth_preset: expected one of {', '.join(presets)}, found "
                    f"'{camera.depth_preset}'"
                )
        self._connect = connect or _Devices(self._dai, self._cameras).connect
        self.calibrations: dict[str, FactoryCalibration] = {}
        """By camera name, of every device that has been connected."""

    def _stamps(self) -> CaptureStamps:
        return CaptureStamps(steady=lambda: _ns(self._dai.Clock.now()))

    def _read(self, camera: OakCamera, stamps: CaptureStamps, connected: Callable[[], None]) -> str:
        try:
            streams = self._connect(camera)
        except RuntimeError as error:  # depthai's own: busy, no permission, wrong firmware
            return " ".join(str(error).split())
        if streams is None:
            return f"device '{camera.device or 'any'}' not found; looking again every {RETRY_S:g} s"
        connected()
        if streams.calibration is not None:
            self.calibrations[camera.name] = streams.calibration
        return self._stream(camera, streams, stamps)

    def _stream(self, camera: OakCamera, streams: OakStreams, stamps: CaptureStamps) -> str:
        """Images until the device is lost, or the source closed; says why it ended."""
        depths: list[Any] = []
        bender = DepthBender(streams.calibration)
        heard = time.monotonic()
        try:
            while not self._queue.closed.is_set():
                frame = streams.colour.get(_timeout())
                if frame is None:
                    if time.monotonic() - heard > STALLED_S:
                        return f"sends nothing, for {STALLED_S:g} s; opening it anew"
                    continue
                heard, depth = time.monotonic(), None
                if streams.depth is not None:
                    depths = [*depths, *streams.depth.tryGetAll()][-QUEUED_PER_CAMERA:]
                    paired = _paired(frame, depths, streams.depth)
                    depth = None if paired is None else bender(_metres(paired), paired, frame)
                stamp = stamps.of_steady(_ns(_mid_exposure(self._dai, frame)))
                self._queue.put(CameraImage(camera.name, stamp, _rgb(frame), depth))
        except (RuntimeError, self._dai.MessageQueue.QueueException) as error:
            return f"lost ({' '.join(str(error).split())}); looking for it every {RETRY_S:g} s"
        finally:
            with contextlib.suppress(RuntimeError):  # depthai's word where the device has gone: there is nothing to end
                streams.close()
        return "closed"


class _Devices:
    """The devices that are plugged in."""

    def __init__(self, dai: Any, cameras: Sequence[OakCamera]) -> None:
        """Raises `RigError` where chance would decide which device is which camera, and so where each is said to be."""
        unnamed = [camera.name for camera in cameras if not camera.device]
        if len(unnamed) > 1:
            raise RigError(
                f"cameras {', '.join(unnamed)}: expected `device` of all but one, found none: devices come in any "
                "order and would take each other's place in the rig; `twin_node doctor --devices` lists them"
            )
        self._dai = dai
        self._named = {camera.device for camera in cameras if camera.device}
        self._taken: set[str] = set()
        self._lock = threading.Lock()

    def connect(self, camera: OakCamera) -> OakStreams | None:
        """Opens a camera's device; None where it is not there.

        What is plugged in is asked first: depthai waits ten seconds for a device that is not.
        """
        with self._lock:
            info = self._find(camera)
            if info is None:
                return None
            identifier = info.getDeviceId()
            self._taken.add(identifier)
        try:
            return _Pipeline(self._dai, camera, info, lambda: self._taken.discard(identifier))
        except BaseException:
            self._taken.discard(identifier)
            raise

    def _find(self, camera: OakCamera) -> Any | None:
        for info in self._dai.Device.getAllAvailableDevices():
            names = {info.getDeviceId(), info.name}
            is_meant = camera.device in names if camera.device else not names & self._named
            if is_meant and info.getDeviceId() not in self._taken:
                return info
        return None


class _Pipeline:
    """A device's pipeline: colour, and depth by stereo aligned with it."""

    def __init__(self, dai: Any, camera: OakCamera, info: Any, on_close: Callable[[], None]) -> None:
        self._on_close = on_close
        self._pipeline = dai.Pipeline(dai.Device(info))
        colour_socket = dai.CameraBoardSocket.CAM_A
        node = self._pipeline.create(dai.node.Camera).build(colour_socket)
        _set_camera(dai, node.initialControl, camera)
        size = (camera.width, camera.height)
        output = node.requestOutput(size, dai.ImgFrame.Type.BGR888i, fps=camera.fps)
        self.colour = output.createOutputQueue(maxSize=QUEUED_PER_CAMERA, blocking=False)
        self.depth = self._stereo(dai, camera) if camera.depth else None
        handler = self._pipeline.getDefaultDevice().readCalibration()
        self.calibration = factory_calibration(handler, colour_socket, *size)
        self._pipeline.start()

    def close(self) -> None:
        """Ends the pipeline and lets go of the device."""
        try:
            self._pipeline.stop()
        finally:
            self._on_close()

    def _stereo(self, dai: Any, camera: OakCamera) -> Any:
        size = (camera.width, camera.height)
        sides = []
        for socket in (dai.CameraBoardSocket.CAM_B, dai.CameraBoardSocket.CAM_C):
            side = self._pipeline.create(dai.node.Camera).build(socket)
            _set_camera(dai, side.initialControl, camera)
            sides.append(side.requestOutput(size, fps=camera.fps))
        preset = getattr(dai.node.StereoDepth.PresetMode, camera.depth_preset)
        stereo = self._pipeline.create(dai.node.StereoDepth).build(*sides, presetMode=preset)
        stereo.setDepthAlign(dai.CameraBoardSocket.CAM_A)
        stereo.setOutputSize(*size)
        return stereo.depth.createOutputQueue(maxSize=QUEUED_PER_CAMERA, blocking=False)


def _set_camera(dai: Any, control: Any, camera: OakCamera) -> None:
    modes = dai.CameraControl.FrameSyncMode
    chosen = {"auto": modes.AUTO, "output": modes.OUTPUT, "input": modes.INPUT, "ptp": modes.TIME_PTP}
    if camera.sync in chosen:
        control.setFrameSyncMode(chosen[camera.sync])
    if camera.exposure_us:
        control.setManualExposure(camera.exposure_us, camera.iso)


def _depthai() -> Any:
    try:
        import depthai
    except ImportError:
        raise RigError("OAK cameras need depthai: pip install depthai") from None
    return depthai


def _timeout(seconds: float = WAIT_S) -> Any:
    from datetime import timedelta

    return timedelta(seconds=seconds)


def _ns(span: Any) -> int:
    """A `timedelta` in ns, to its microsecond."""
    return int((span.days * 86_400 + span.seconds) * 1_000_000 + span.microseconds) * 1_000


def _mid_exposure(dai: Any, frame: Any) -> Any:
    return frame.getTimestamp(dai.CameraExposureOffset.MIDDLE)


def _rgb(frame: Any) -> Any:
    return np.asarray(cv2.cvtColor(frame.getCvFrame(), cv2.COLOR_BGR2RGB), dtype=np.uint8)


def _metres(depth: Any) -> Float32:
    return np.asarray(depth.getFrame(), dtype=np.uint16).astype(np.float32) / np.float32(1000)


def _paired(frame: Any, depths: list[Any], waiting: Any) -> Any | None:
    """The depth frame of the frame's exposure; waits for it `WAIT_S` in all, whatever comes before it."""
    stamp, deadline = _ns(frame.getTimestamp()), time.monotonic() + WAIT_S
    while not depths or _ns(depths[-1].getTimestamp()) < stamp - PAIR_TOLERANCE_NS:
        late = waiting.get(_timeout(max(deadline - time.monotonic(), 0.0)))
        if late is None:
            break
        depths.append(late)
    near = [d for d in depths if abs(_ns(d.getTimestamp()) - stamp) <= PAIR_TOLERANCE_NS]
    if not near:
        return None
    return min(near, key=lambda d: abs(_ns(d.getTimestamp()) - stamp))


def plugged_in() -> tuple[str, ...]:
    """One line for every device that depthai finds. Raises `RigError` where depthai is not installed."""
    found = _depthai().Device.getAllAvailableDevices()
    return tuple(f"{info.getDeviceId()}  {info.name}  {info.state.name}" for info in found)
