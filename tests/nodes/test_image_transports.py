"""Recordings of all that image_transport offers beside an image: which form of it is read, and what none holds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from zstd_images import packed

from twin_node.bag import LogWriter
from twin_node.messages import Message, convert
from twin_node.nodes.live.rig_source import RigParameters, topics_of
from twin_node.nodes.log_source import LogSession, LogSource
from twin_node.nodes.synchronizer import SynchronizerParameters
from twin_node.nodes.topics import CAMERA_INFO, COMPRESSED, RAW, find_cameras
from twin_node.scene import Rig, RigCamera

K = np.array([[64.0, 0, 31.5], [0, 64, 23.5], [0, 0, 1]])
WORKSPACE = np.array([[-1, -1, 0.2], [1, 1, 2.0]])
RGB = np.full((48, 64, 3), 90, np.uint8)
METRES = np.full((48, 64), 1.5, np.float32)
FORMS = ("", "/compressed", "/compressedDepth", "/zstd")


def jpeg_of_depth() -> Message:
    """As compressed_image_transport sends 16UC1: what is farther than 255 mm is 255."""
    levels = np.minimum(METRES * 1000, 255).astype(np.uint8)
    data = cv2.imencode(".jpg", levels)[1].reshape(-1)
    return replace(convert.compressed_image("cam", 5, RGB), format="16UC1; jpeg compressed ", data=data)


def log_of(path: Path, depth: str, forms: tuple[str, ...], colour_forms: tuple[str, ...] = ("",)) -> Path:
    """One set of a camera `/oak/rgb`, whose depth is on the topic `depth` in some of the forms."""
    images = {"": convert.raw_image("cam", 5, RGB), "/compressed": convert.compressed_image("cam", 5, RGB)}
    images["/zstd"] = packed(images[""])
    depths = {"": convert.depth_image("cam", 5, METRES, "16UC1"), "/compressed": jpeg_of_depth()}
    depths |= {"/compressedDepth": convert.compressed_depth_image("cam", 5, METRES), "/zstd": packed(depths[""])}
    with LogWriter(path) as log:
        log.write("/oak/rgb/camera_info", convert.camera_info(RigCamera("oak", 64, 48, K, np.eye(4)), 5), 5)
        for form in colour_forms:
            log.write(f"/oak/rgb/image_raw{form}", images[form], 5)
        for form in forms:
            log.write(f"{depth}{form}", depths[form], 5)
    return path


RIG = Rig((RigCamera("oak", 64, 48, K, np.eye(4)),), WORKSPACE)


@pytest.mark.parametrize("depth", ["/oak/stereo/image_raw", "/oak/depth/image_raw"])
@pytest.mark.parametrize("forms", [FORMS, FORMS[1:], ("/compressed", "/zstd"), ("/zstd",)])
def test_depth_is_read_from_a_form_that_keeps_it(tmp_path: Path, depth: str, forms: tuple[str, ...]) -> None:
    """`ros2 bag record -a` has all: the JPEG came first by the alphabet, which is no depth, or, of depthai_ros, made
    a camera of its own beside that which lost its depth."""
    with LogSession(log_of(tmp_path / "log.mcap", depth, forms), RIG) as session:
        assert [camera.name for camera in session.cameras] == ["oak"]
        assert session.doubts == ()
        [frames] = LogSource(session, SynchronizerParameters())
    [view] = frames.views
    assert view.depth is not None
    np.testing.assert_allclose(view.depth, METRES)


def test_depth_in_jpeg_alone_is_told(tmp_path: Path) -> None:
    for number, depth in enumerate(("/oak/stereo/image_raw", "/oak/depth/image_raw")):
        with LogSession(log_of(tmp_path / f"{number}.mcap", depth, ("/compressed",)), RIG) as session:
            assert session.cameras[0].depth is None
            assert session.doubts == (
                f"{depth}/compressed is left out: it holds depth as JPEG, which keeps 8 of its 16 bits; record "
                f"{depth}/compressedDepth",
            )


def test_colour_images_that_zstd_alone_holds_are_read(tmp_path: Path) -> None:
    path = log_of(tmp_path / "log.mcap", "/oak/stereo/image_raw", (), ("/zstd",))
    with LogSession(path, RIG) as session:
        assert session.cameras[0].info == "/oak/rgb/camera_info"
        [frames] = LogSource(session, SynchronizerParameters())
    np.testing.assert_array_equal(frames.views[0].rgb, RGB)


def test_of_an_images_forms_the_one_that_is_quickest_to_read_is_taken() -> None:
    topics = {"/cam/image_raw": RAW, "/cam/image_raw/zstd": COMPRESSED, "/cam/camera_info": CAMERA_INFO}
    assert find_cameras(topics, "log")[0].image == "/cam/image_raw"
    [camera] = find_cameras({**topics, "/cam/image_raw/compressed": COMPRESSED}, "log")
    assert camera.image == "/cam/image_raw/compressed"


def test_a_live_camera_sends_what_its_topics_names_say() -> None:
    rig = RigParameters(file="rig.yaml", image="image_raw/zstd", depth="depth/image_rect/zstd")
    topics = topics_of("cam", rig)
    assert (topics.image_type, topics.depth_type, topics.info) == (COMPRESSED, COMPRESSED, "/cam/camera_info")
    topics = topics_of("cam", replace(rig, image="image_raw", depth="depth/image_rect"))
    assert (topics.image_type, topics.depth_type) == (RAW, RAW)
