"""OpenCV's cameras: a video as a camera, one that fails and comes back, and sets made of several."""

from __future__ import annotations

import itertools
import weakref
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

from twin_node.rig import RigError
from twin_node.rig.cameras import CameraImage, CaptureStamps, OpenCvCamera, OpenCvSource, SynchronizedSource
from twin_node.scene import JointSample, Rig, RigCamera


@pytest.fixture
def video(tmp_path: Path) -> Path:
    path = tmp_path / "grey.avi"
    writer = cv2.VideoWriter(str(path), cv2.VideoWriter.fourcc(*"MJPG"), 100.0, (32, 24))
    for level in range(5):
        writer.write(np.full((24, 32, 3), 40 * level, np.uint8))
    writer.release()
    return path


def test_a_video_is_played_again_and_again(video: Path) -> None:
    """Where the test is kept waiting, images are left out."""
    source = OpenCvSource([OpenCvCamera("front", str(video))])
    images: list[CameraImage] = []
    for image in itertools.islice(source.images(), 1000):
        images.append(image)
        steps = np.diff([one.rgb.mean() for one in images])
        if (steps > 20).any() and (steps < -100).any():
            break
    source.close()
    assert (steps > 20).any() and (steps < -100).any()  # it has gone on, and begun again
    assert all(a.stamp < b.stamp for a, b in itertools.pairwise(images))
    assert source.health[0].is_connected is False


class FailsOnce:
    """A camera that gives two images, is gone, and is back."""

    def __init__(self, opened: list[int]) -> None:
        opened.append(1)
        self._left = 2

    def isOpened(self) -> bool:
        return True

    def get(self, key: int) -> float:
        return 0.0

    def set(self, key: int, value: float) -> bool:
        return True

    def read(self) -> tuple[bool, Any]:
        self._left -= 1
        return self._left >= 0, np.zeros((4, 4, 3), np.uint8)

    def release(self) -> None:
        pass


class Breaks(FailsOnce):
    """A camera whose backend raises when it is gone, as some do."""

    def __init__(self, opened: list[int], released: list[int]) -> None:
        super().__init__(opened)
        self._released = released

    def read(self) -> tuple[bool, Any]:
        ok, image = super().read()
        if not ok:
            raise cv2.error("Unknown C++ exception from OpenCV code")
        return ok, image

    def release(self) -> None:
        self._released.append(1)


def test_a_camera_that_breaks_is_let_go_and_opened_again(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """It was gone for as long as the process ran, and nobody else could open it."""
    monkeypatch.setattr("twin_node.rig.cameras.threaded_source.RETRY_S", 0.0)
    opened: list[int] = []
    released: list[int] = []
    source = OpenCvSource([OpenCvCamera("usb", "0")], lambda address: Breaks(opened, released))
    images = [image for image, _ in zip(source.images(), range(7), strict=False)]
    assert len(images) == 7
    assert len(opened) >= 4
    source.close()
    assert len(released) == len(opened)
    assert capsys.readouterr().err.count("Traceback") == 1, "the same fault again is no news"


def test_a_camera_that_fails_is_opened_again() -> None:
    opened: list[int] = []
    source = OpenCvSource([OpenCvCamera("usb", "0", width=640)], lambda address: FailsOnce(opened))
    images = [image for image, _ in zip(source.images(), range(3), strict=False)]
    assert len(images) == 3
    assert len(opened) == 2
    source.close()


class Runs(FailsOnce):
    """A camera that goes on and on."""

    def read(self) -> tuple[bool, Any]:
        return True, np.zeros((4, 4, 3), np.uint8)


def test_images_that_are_asked_for_again_come_from_the_same_camera() -> None:
    """Each time another thread opened it once more: a video's images came twice, a USB camera was busy."""
    opened: list[int] = []
    source = OpenCvSource([OpenCvCamera("usb", "0")], lambda address: Runs(opened))
    first, second = next(source.images()), next(source.images())
    source.close()
    assert first.stamp < second.stamp
    assert len(opened) == 1


def rig_of(*names: str) -> Rig:
    K = np.array([[30.0, 0, 15.5], [0, 30.0, 11.5], [0, 0, 1]])
    poses = np.stack([np.eye(4)] * len(names))
    return Rig(tuple(RigCamera(name, 32, 24, K, pose) for name, pose in zip(names, poses, strict=True)))


def test_sets_of_running_cameras(video: Path) -> None:
    cameras = OpenCvSource([OpenCvCamera("a", str(video)), OpenCvCamera("b", str(video))])
    source = SynchronizedSource(cameras, rig_of("a", "b"))
    frames = next(iter(source))
    cameras.close()
    assert [view.camera.name for view in frames.views] == ["a", "b"]
    assert source.report.sets >= 1


class Recorded:
    """Images of two cameras, 33 ms apart, and the host's clock when each comes; it is put back half-way."""

    cameras, health = ("a", "b"), ()

    def __init__(self, back_ns: int, kind: type = int, prefix: str = "") -> None:
        """`kind`: of the stamps; `prefix`: before the names that images have."""
        self.now = 0
        self._back_ns, self._kind, self._prefix = back_ns, kind, prefix

    def images(self) -> Iterator[CameraImage]:
        steady = 0
        stamps = {name: CaptureStamps(lambda: self.now, lambda: steady) for name in self.cameras}
        for number in range(40):
            steady = number * 33_000_000
            self.now = 10**18 + steady - (self._back_ns if number >= 20 else 0)
            for name in self.cameras:
                stamp = self._kind(stamps[name].of_arrival(5_000_000))
                yield CameraImage(self._prefix + name, stamp, np.zeros((24, 32, 3), np.uint8))

    def close(self) -> None:
        pass


@pytest.mark.parametrize("back_ms", [80, 300, 450, 3_600_000])
def test_sets_go_on_when_the_hosts_clock_is_put_back(monkeypatch: pytest.MonkeyPatch, back_ms: int) -> None:
    recorded = Recorded(back_ms * 1_000_000)
    monkeypatch.setattr("time.time_ns", lambda: recorded.now)
    source = SynchronizedSource(recorded, rig_of("a", "b"))
    assert len(list(source)) > 35
    assert [one.future for one in source.report.inputs] == [0, 0]


def test_stamps_are_the_rigs_and_joints_come_beside_them(monkeypatch: pytest.MonkeyPatch) -> None:
    recorded, (a, b) = Recorded(0), rig_of("a", "b").cameras
    monkeypatch.setattr("time.time_ns", lambda: recorded.now)
    of_a_recording = {"time_offset_ns": 10**9, "time_rate_ppm": 2.0, "time_reference_ns": 5 * 10**9}
    source = SynchronizedSource(recorded, Rig((replace(a, **of_a_recording), replace(b, time_offset_ns=-12_000_000))))
    source.add_joints(JointSample(10**18, ("elbow_joint",), np.ones(1), np.zeros(1)))
    sets = list(source)
    assert {frames.views[0].stamp - frames.views[1].stamp for frames in sets} == {12_000_000}
    assert sets[0].joints is not None and sets[0].joints.names == ("elbow_joint",)
    assert sets[-1].joints is None


def test_joints_that_are_told_while_no_image_comes_are_not_kept_for_ever() -> None:
    source = SynchronizedSource(Recorded(0), rig_of("a", "b"))
    samples = [JointSample(number * 10**9, ("elbow_joint",), np.ones(1), np.zeros(1)) for number in range(5)]
    first, last = weakref.ref(samples[0]), weakref.ref(samples[-1])
    while samples:
        source.add_joints(samples.pop(0))
    assert first() is None
    assert last() is not None


def test_stamps_that_numpy_counts_are_as_good(monkeypatch: pytest.MonkeyPatch) -> None:
    """Unsigned ones were all in the future: what is less than nothing wraps around."""
    recorded = Recorded(0, np.uint64)
    monkeypatch.setattr("time.time_ns", lambda: recorded.now)
    assert len(list(SynchronizedSource(recorded, rig_of("a", "b")))) > 35


def test_an_image_of_no_camera_of_the_rig_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    recorded = Recorded(0, prefix="cam_")
    monkeypatch.setattr("time.time_ns", lambda: recorded.now)
    with pytest.raises(RigError, match="expected images of a, b, found one of 'cam_a'; name them alike"):
        list(SynchronizedSource(recorded, rig_of("a", "b")))


def test_wrong_names_are_told(video: Path) -> None:
    with pytest.raises(RigError, match="distinct names, found none"):
        OpenCvSource([])
    cameras = OpenCvSource([OpenCvCamera("a", str(video))])
    with pytest.raises(RigError, match=r"expected those of the rig file \(left\), found a"):
        SynchronizedSource(cameras, rig_of("left"))


@pytest.mark.parametrize(
    ("settings", "said"),
    [
        ({"address": ""}, "camera front: address: expected a number, a URL or a path, found none"),
        ({"width": -640}, "camera front: width: expected a number of 0 or more, found -640"),
        ({"fps": -30.0}, "camera front: fps: expected a number of 0 or more, found -30"),
        ({"latency_ms": float("inf")}, "camera front: latency_ms: expected a number of 0 or more, found inf"),
        ({"latency_ms": -5.0}, "camera front: latency_ms: expected a number of 0 or more, found -5"),
    ],
)
def test_settings_that_cannot_be_are_named(settings: dict[str, Any], said: str) -> None:
    """Else a camera's thread would end with the first image, or its stamps would lie ahead."""
    with pytest.raises(RigError, match=said):
        OpenCvCamera(**{"name": "front", "address": "0", **settings})
