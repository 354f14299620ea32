"""The OAK driver on depthai's host nodes: stamps, aligned depth, unplugging and return, factory calibration."""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

dai = pytest.importorskip("depthai")

from host_oak import DEPTH_MM, HostStreams, LateDepthStreams  # noqa: E402 (needs depthai)

from twin_node.rig import RigError  # noqa: E402
from twin_node.rig.cameras import CameraImage  # noqa: E402
from twin_node.rig.cameras.oak import OakCamera, OakSource  # noqa: E402
from twin_node.rig.cameras.oak_lens import DepthBender, FactoryCalibration, factory_calibration  # noqa: E402
from twin_node.rig.undistort import distort  # noqa: E402
from twin_node.scene import RigCamera  # noqa: E402

FRONT = OakCamera("front", width=64, height=48)
LEFT = OakCamera("left", width=64, height=48, depth=False)


class Bench:
    """Devices that can be unplugged."""

    def __init__(self) -> None:
        self.streams: dict[str, list[HostStreams]] = {}

    def connect(self, camera: OakCamera) -> HostStreams:
        streams = HostStreams(camera)
        self.streams.setdefault(camera.name, []).append(streams)
        return streams


@pytest.fixture
def bench() -> Bench:
    return Bench()


@pytest.fixture
def source(bench: Bench) -> Iterator[OakSource]:
    source = OakSource([FRONT, LEFT], bench.connect)
    yield source
    source.close()


def take(images: Iterator[CameraImage], camera: str, count: int) -> list[CameraImage]:
    return [image for image, _ in zip((i for i in images if i.camera == camera), range(count), strict=False)]


def test_images_come_with_rising_stamps_of_this_host_and_aligned_depth(source: OakSource) -> None:
    begun = time.time_ns()
    images = source.images()
    front = take(images, "front", 6)
    stamps = [image.stamp for image in front]
    assert stamps == sorted(set(stamps))
    assert begun - 1_000_000_000 < stamps[0] and stamps[-1] <= time.time_ns()
    assert front[0].rgb.shape == (48, 64, 3)
    assert tuple(front[0].rgb[0, 0]) == (200, 20, 10)
    with_depth = [image for image in front if image.depth is not None]
    assert len(with_depth) >= 3
    assert np.allclose(with_depth[0].depth, DEPTH_MM / 1000)
    assert take(images, "left", 1)[0].depth is None


@pytest.mark.parametrize(("first_depth", "lost_colour"), [(-1, None), (0, 4)])
def test_depth_that_comes_later_and_out_of_step_is_waited_for(first_depth: int, lost_colour: int | None) -> None:
    source = OakSource([FRONT], lambda camera: LateDepthStreams(camera, first_depth, lost_colour))
    assert all(image.depth is not None for image in take(source.images(), "front", 8))
    source.close()


def test_an_unplugged_device_is_told_and_taken_back_while_the_other_goes_on(source: OakSource, bench: Bench) -> None:
    images = source.images()
    take(images, "front", 2)
    bench.streams["front"][0].unplug()
    while len(bench.streams["front"]) < 2:
        take(images, "left", 1)
    take(images, "front", 2)
    [front, left] = source.health
    assert (front.is_connected, front.reconnections) == (True, 1)
    assert (left.is_connected, left.reconnections) == (True, 0)


def test_a_device_that_cannot_even_be_let_go_is_looked_for_again(monkeypatch: pytest.MonkeyPatch) -> None:
    """A pulled cable: depthai may have nobody left to tell that the pipeline ends."""
    monkeypatch.setattr("twin_node.rig.cameras.oak.RETRY_S", 0.01)
    gone = Bench()

    class Vanishing(HostStreams):
        def close(self) -> None:
            super().close()
            raise RuntimeError("X_LINK_ERROR")

    def connect(camera: OakCamera) -> HostStreams:
        streams = Vanishing(camera)
        gone.streams.setdefault(camera.name, []).append(streams)
        return streams

    source = OakSource([LEFT], connect)
    images = source.images()
    take(images, "left", 1)
    gone.streams["left"][0].unplug()
    deadline = time.monotonic() + 20
    while len(gone.streams["left"]) < 2 and time.monotonic() < deadline:
        assert "thread failed" not in source.health[0].message
        time.sleep(0.01)
    assert len(gone.streams["left"]) >= 2
    source.close()


def test_a_device_that_sends_nothing_is_opened_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    """It is there, and says nothing of why: it was connected, and silent, for good."""
    monkeypatch.setattr("twin_node.rig.cameras.oak.RETRY_S", 0.0)
    monkeypatch.setattr("twin_node.rig.cameras.oak.STALLED_S", 0.01)
    ended: list[str] = []
    mute = SimpleNamespace(get=lambda _: None)
    stalled = SimpleNamespace(colour=mute, depth=None, calibration=None, close=lambda: ended.append("stalled"))
    opened = iter([stalled])
    source = OakSource([LEFT], lambda camera: next(opened, None) or HostStreams(camera))
    take(source.images(), "left", 2)
    assert ended == ["stalled"]
    assert (source.health[0].is_connected, source.health[0].reconnections) == (True, 1)
    source.close()


def test_a_device_that_is_not_there_is_said_to_be_missing() -> None:
    source = OakSource([FRONT, LEFT], lambda camera: HostStreams(camera) if camera is LEFT else None)
    images = source.images()
    take(images, "left", 2)
    assert not source.health[0].is_connected
    assert "device 'any' not found; looking again" in source.health[0].message
    source.close()


def test_without_a_device_nothing_waits_for_one() -> None:
    from twin_node.rig.cameras.oak import plugged_in

    assert plugged_in() == ()


def test_factory_calibration_is_scaled_to_the_image() -> None:
    handler = dai.CalibrationHandler()
    socket = dai.CameraBoardSocket.CAM_A
    handler.setCameraIntrinsics(socket, [[800.0, 0.0, 640.0], [0.0, 800.0, 360.0], [0.0, 0.0, 1.0]], 1280, 720)
    handler.setDistortionCoefficients(socket, [0.1, -0.2, 0.0, 0.0, 0.05] + [0.0] * 9)
    found = factory_calibration(handler, socket, 640, 360)
    assert found is not None
    assert found.K[0, 0] == pytest.approx(400.0)
    assert found.D.tolist() == pytest.approx([0.1, -0.2, 0.0, 0.0, 0.05, 0.0, 0.0, 0.0])
    assert factory_calibration(handler, dai.CameraBoardSocket.CAM_B, 640, 360) is None


BENT = np.array([-0.3, 0.1, 0, 0, 0, 0, 0, 0])
LENS = np.array([[60.0, 0, 31.5], [0, 60, 23.5], [0, 0, 1]])


@pytest.mark.parametrize("is_fisheye", [False, True])
def test_depth_is_brought_onto_the_pixels_that_the_lens_has_bent(is_fisheye: bool) -> None:
    """The device aligns it with the colour image without its distortion; the depth of each pixel tells its column."""
    factory = FactoryCalibration(LENS, np.array([-0.1, 0.02, 0, 0]) if is_fisheye else BENT, is_fisheye)
    columns = np.tile(np.arange(64, dtype=np.float32), (48, 1))
    rays = np.stack(np.meshgrid((np.arange(64) - 31.5) / 60, (np.arange(48) - 23.5) / 60), -1)
    camera = RigCamera("front", 64, 48, LENS, np.eye(4), "equidistant" if is_fisheye else "rational_polynomial")
    bent = distort(replace(camera, D=factory.D), rays.reshape(-1, 2)).reshape(48, 64, 2)
    found = DepthBender(factory)(columns, dai.ImgFrame(), dai.ImgFrame())
    column, row = np.rint(bent[8:40, 8:56]).astype(int).transpose(2, 0, 1)
    np.testing.assert_allclose(found[row, column], columns[8:40, 8:56], atol=1.1)


@pytest.mark.parametrize(
    ("colour", "depth", "is_bent"), [(BENT, BENT * 0, True), (BENT, BENT, False), (BENT * 0, BENT * 0, False)]
)
def test_depth_that_says_how_it_lies_is_believed(colour: np.ndarray, depth: np.ndarray, is_bent: bool) -> None:
    def frame(D: np.ndarray) -> dai.ImgFrame:
        found, told = dai.ImgFrame(), dai.ImgTransformation(64, 48)
        told.setDistortionCoefficients(D.tolist())
        found.setTransformation(told)
        return found

    columns = np.tile(np.arange(64, dtype=np.float32), (48, 1))
    found = DepthBender(FactoryCalibration(LENS, BENT))(columns, frame(depth), frame(colour))
    assert (found is not columns) == is_bent


def test_the_source_bends_depth_by_what_its_device_was_calibrated_to() -> None:
    source = OakSource([FRONT], lambda camera: HostStreams(camera, FactoryCalibration(LENS, 4 * BENT)))
    with_depth = next(image for image in source.images() if image.depth is not None)
    source.close()
    assert with_depth.depth[24, 32] == np.float32(DEPTH_MM / 1000)
    assert with_depth.depth[0, 0] == 0  # in the image without distortion it would lie outside


def test_wrong_settings_are_named() -> None:
    with pytest.raises(RigError, match="sync: expected one of none, auto, output, input, ptp, found 'cable'"):
        OakCamera("front", sync="cable")
    with pytest.raises(RigError, match="camera front: width: expected 16 to 16384, found 0"):
        OakCamera("front", width=0)
    with pytest.raises(RigError, match="camera front: fps: expected a number above 0, found -30"):
        OakCamera("front", fps=-30.0)
    with pytest.raises(RigError, match="camera front: exposure_us: expected a number of 0 or more, found -1"):
        OakCamera("front", exposure_us=-1)
    with pytest.raises(RigError, match=r"depth_preset: expected one of .*ROBOTICS.* found 'BEST'"):
        OakSource([OakCamera("front", depth_preset="BEST")])
    with pytest.raises(RigError, match="distinct names"):
        OakSource([FRONT, FRONT])
    with pytest.raises(RigError, match="front and left: expected a device each, found '14442C10' for both"):
        OakSource([OakCamera("front", "14442C10"), OakCamera("left", "14442C10")])


def test_devices_that_chance_would_tell_apart_are_refused() -> None:
    """Two cameras of one kind, swapped: each would stand where the other is, and nothing would show it."""
    with pytest.raises(RigError, match="cameras front, left: expected `device` of all but one, found none"):
        OakSource([FRONT, LEFT, OakCamera("right", "14442C10")])
    OakSource([FRONT, OakCamera("right", "14442C10")]).close()
