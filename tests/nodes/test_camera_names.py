"""Which of several topics with colour images a camera is read from."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twin_node.bag import LogWriter, open_log
from twin_node.messages import convert
from twin_node.nodes.log_check import check_log
from twin_node.nodes.log_source import LogSession
from twin_node.nodes.topics import CAMERA_INFO, COMPRESSED, RAW, find_cameras
from twin_node.scene import Rig, RigCamera

CAMERA = RigCamera("cam", 64, 48, np.array([[64.0, 0, 31.5], [0, 64, 23.5], [0, 0, 1]]), np.eye(4))


@pytest.mark.parametrize(
    ("topics", "image"),
    [
        ({"/cam/image_raw": RAW, "/cam/image_annotated": RAW}, "/cam/image_raw"),
        ({"/cam/image_raw": RAW, "/cam/image_annotated/compressed": COMPRESSED}, "/cam/image_raw"),
        ({"/cam/image_rect_color": RAW, "/cam/image_debug": RAW}, "/cam/image_rect_color"),
        ({"/cam/image": RAW, "/cam/image_detections": COMPRESSED}, "/cam/image"),
        ({"/cam/image_raw": RAW, "/cam/image_raw/compressed": COMPRESSED}, "/cam/image_raw/compressed"),
        ({"/cam/image_annotated": RAW}, "/cam/image_annotated"),
    ],
)
def test_what_somebody_has_drawn_on_is_not_taken_for_a_cameras_images(topics: dict[str, str], image: str) -> None:
    """A detector publishes its boxes beside the images: by the alphabet they were the camera's."""
    [camera] = find_cameras({**topics, "/cam/camera_info": CAMERA_INFO}, "log")
    assert camera.image == image


ZED = "/zed/zed_node"


@pytest.mark.parametrize("form", ["", "/compressed"])
def test_a_zed_is_read_from_the_images_that_its_depth_is_of(form: str) -> None:
    """Its wrapper has raw and rectified images side by side since 5.1: the raw ones came first by the alphabet."""
    kind = COMPRESSED if form else RAW
    images = [f"{ZED}/rgb/color/{of}/image{form}" for of in ("raw", "rect")]
    below = {f"{ZED}/{image}/camera_info": CAMERA_INFO for image in ("rgb/color/raw/image", "rgb/color/rect/image")}
    below[f"{ZED}/depth/depth_registered/camera_info"] = CAMERA_INFO
    depth = f"{ZED}/depth/depth_registered"
    [camera] = find_cameras({**dict.fromkeys(images, kind), depth: RAW, **below}, "log")
    assert (camera.name, camera.image, camera.is_rectified) == ("zed_zed_node", images[1], True)
    assert (camera.info, camera.depth_info) == (f"{ZED}/rgb/color/rect/image/camera_info", f"{depth}/camera_info")
    beside = {f"{ZED}/rgb/color/rect/camera_info": CAMERA_INFO, f"{ZED}/depth/camera_info": CAMERA_INFO}
    [camera] = find_cameras({**dict.fromkeys(images, kind), depth: RAW, **beside}, "log")
    assert (camera.info, camera.depth_info) == (f"{ZED}/rgb/color/rect/camera_info", f"{ZED}/depth/camera_info")


def log_of(path: Path, *folders: str) -> Path:
    with LogWriter(path) as log:
        for folder in folders:
            log.write(f"{folder}/camera_info", convert.camera_info(CAMERA, 5), 5)
            for name in ("image_raw", "image_rect"):
                image = convert.raw_image("cam", 5, np.zeros((48, 64, 3), np.uint8))
                log.write(f"{folder}/{name}", image, 5)
    return path


def test_a_second_camera_of_one_name_is_told(tmp_path: Path) -> None:
    """Two devices whose names come out alike were one, in silence; rectified images of the one are no second."""
    rig = Rig((CAMERA,))
    with LogSession(log_of(tmp_path / "one.mcap", "/cam"), rig) as session:
        assert session.doubts == ()
    two = log_of(tmp_path / "two.mcap", "/cam/color", "/cam/rgb")
    with LogSession(two, rig) as session:
        (line,) = session.doubts
        assert line.startswith("/cam/rgb/image_raw is left out: the images of a camera 'cam' are on /cam/color/image_")
    with open_log(two) as log:
        assert line in check_log(log).faults
    with LogSession(two, rig, {"/cam/rgb/image_raw": "/other/image_raw", "/cam/rgb/image_rect": "/b/c"}) as session:
        assert [line for line in session.doubts if "the images of a camera" in line] == []
