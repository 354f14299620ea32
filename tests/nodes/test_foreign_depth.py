"""Depth as drivers of others record it: that of the colour image's pixels is taken, another lens's is refused."""

import contextlib
import re
import warnings
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest
from mcap.writer import Writer

from twin_node.bag import LogWriter, open_log
from twin_node.messages import builtin_types, convert, message_type, serialize
from twin_node.messages.convert.camera import optical_frame
from twin_node.nodes.log_check import check_log
from twin_node.nodes.log_source import LogSession, LogSource
from twin_node.nodes.synchronizer import SynchronizerParameters
from twin_node.nodes.topics import CAMERA_INFO, COMPRESSED, RAW, GraphError, find_cameras
from twin_node.scene import Rig, RigCamera

CAMERA = "/camera/camera"
COLOUR, DEPTH, ALIGNED = f"{CAMERA}/color", f"{CAMERA}/depth", f"{CAMERA}/aligned_depth_to_color"


@pytest.mark.parametrize(
    ("others", "depth"),
    [
        ({f"{DEPTH}/image_rect_raw": RAW}, f"{DEPTH}/image_rect_raw"),
        ({f"{DEPTH}/image_rect_raw": RAW, f"{ALIGNED}/image_raw": RAW}, f"{ALIGNED}/image_raw"),
        (
            {f"{DEPTH}/image_rect_raw/compressedDepth": COMPRESSED, f"{ALIGNED}/image_raw": RAW},
            f"{ALIGNED}/image_raw",
        ),
        (
            {f"{CAMERA}/depth/image_raw": RAW, f"{CAMERA}/depth_registered/image_raw": RAW},
            f"{CAMERA}/depth_registered/image_raw",
        ),
    ],
)
def test_aligned_depth_is_the_cameras(others: dict[str, str], depth: str) -> None:
    infos = {f"{folder}/camera_info": CAMERA_INFO for folder in (COLOUR, DEPTH)}
    [camera] = find_cameras({f"{COLOUR}/image_raw": RAW, **others, **infos}, "log")
    assert (camera.name, camera.image, camera.depth) == ("camera_camera", f"{COLOUR}/image_raw", depth)
    assert camera.depth_info == (f"{DEPTH}/camera_info" if depth.startswith(f"{DEPTH}/") else None)


def test_colour_images_that_are_taken_for_depth_can_be_renamed() -> None:
    """All of a cell's topics below a namespace that says depth."""
    with pytest.raises(GraphError, match=r"says depth is taken for depth.*--remap"):
        find_cameras({"/depth_rig/left/image_raw": COMPRESSED}, "log")
    with pytest.raises(GraphError, match="record the cameras too"):
        find_cameras({"/depth_rig/left/camera_info": CAMERA_INFO}, "log")


def test_a_colour_image_is_not_taken_from_a_transport_that_can_encode_none() -> None:
    """On a graph image_transport offers it beside every image, and nobody knows yet what will come."""
    offered = {f"{COLOUR}/image_raw": RAW, f"{COLOUR}/image_raw/compressedDepth": COMPRESSED}
    [camera] = find_cameras(offered, "the graph")
    assert (camera.image, camera.depth) == (f"{COLOUR}/image_raw", None)


def foreign_log(path: Path, depth_fx: float, apart_m: float | None = None) -> Path:
    """One set of a camera whose colour has an fx of 64 pixels of 64; its depth comes with a calibration too.

    `apart_m`: how far the depth's frame is from the colour's; None: both are one.
    """
    depth_frame = optical_frame("camera_camera" if apart_m is None else "depth")
    with LogWriter(path) as log:
        if apart_m is not None:
            T = np.eye(4)
            T[0, 3] = apart_m
            transform = convert.transform_stamped(optical_frame("camera_camera"), depth_frame, T, 5)
            log.write("/tf_static", message_type("tf2_msgs/msg/TFMessage")(transforms=[transform]), 5)
        for folder, fx in ((COLOUR, 64.0), (DEPTH, depth_fx)):
            K = np.array([[fx, 0, 31.5], [0, fx, 23.5], [0, 0, 1]])
            log.write(
                f"{folder}/camera_info", convert.camera_info(RigCamera("camera_camera", 64, 48, K, np.eye(4)), 5), 5
            )
        log.write(f"{COLOUR}/image_raw", convert.raw_image("camera_camera", 5, np.zeros((48, 64, 3), np.uint8)), 5)
        depth = convert.depth_image("camera_camera", 5, np.ones((48, 64), np.float32))
        depth.header.frame_id = depth_frame
        log.write(f"{DEPTH}/image_rect_raw", depth, 5)
    return path


def rig_of(path: Path) -> Path:
    path.write_text(
        "cameras:\n- {name: camera_camera, size: [64, 48], K: [[64, 0, 31.5], [0, 64, 23.5], [0, 0, 1]],\n"
        "   T_base_cam: [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1]]}\n"
        "workspace: {min: [-1, -1, 0.2], max: [1, 1, 2]}\n"
    )
    return path


def test_depth_of_another_lens_is_refused_unless_it_is_left_out(tmp_path: Path, refused: Callable[..., str]) -> None:
    log, rig = foreign_log(tmp_path / "log.mcap", 48.0), rig_of(tmp_path / "rig.yaml")
    with pytest.raises(GraphError, match=r"fx of 0.75 widths for 1.00\); record aligned depth") as caught:
        LogSession(log, rig)
    remap = str(caught.value).split("--remap ")[1]
    assert remap in refused("replay", log, "--rig", rig, "--duration", "1", "--report", tmp_path / "report")
    with LogSession(log, rig, dict([remap.split(":=")])) as session:
        assert session.cameras[0].depth is None


@pytest.mark.parametrize("fx", [64.5, 0.0])
def test_depth_of_the_same_lens_and_of_one_that_is_not_calibrated_is_taken(tmp_path: Path, fx: float) -> None:
    with LogSession(foreign_log(tmp_path / "log.mcap", fx), rig_of(tmp_path / "rig.yaml")) as session:
        assert session.cameras[0].depth == f"{DEPTH}/image_rect_raw"


def test_depth_of_a_lens_beside_the_colours_is_refused_where_transforms_tell(tmp_path: Path) -> None:
    """A D455's two lenses have nearly the same focal length, 59 mm from each other; a D405's are one."""
    rig = rig_of(tmp_path / "rig.yaml")
    apart = foreign_log(tmp_path / "d455.mcap", 64.5, 0.059)
    with pytest.raises(GraphError, match=r"depth_optical_frame is 59 mm from camera_camera_optical_frame"):
        LogSession(apart, rig)
    depth = f"{DEPTH}/image_rect_raw"  # whose driver aligns it, and names the frame wrongly
    with LogSession(apart, rig, {depth: f"{ALIGNED}/image_raw"}) as session:
        assert session.cameras[0].depth == f"{ALIGNED}/image_raw"
    with LogSession(foreign_log(tmp_path / "d405.mcap", 64.5, 0.0), rig) as session:
        assert session.cameras[0].depth == f"{DEPTH}/image_rect_raw"


def test_a_check_of_the_log_names_it(tmp_path: Path) -> None:
    for fx, others in ((48.0, 1), (64.5, 0)):
        with open_log(foreign_log(tmp_path / f"{fx}.mcap", fx)) as log:
            check = check_log(log)
        assert len([fault for fault in check.faults if "depth aligned with its colour image" in fault]) == others


def test_a_calibration_is_found_beside_what_was_renamed(tmp_path: Path) -> None:
    """Of images and depth that alone get another name: depth lost its lens, and images had no calibration."""
    foreign_log(tmp_path / "alone.mcap", 63.0)
    place = RigCamera("camera_camera", 64, 48, np.eye(3), np.eye(4))
    with open_log(tmp_path / "alone.mcap") as read, LogWriter(tmp_path / "log.mcap") as log:
        log.write("/tf_static", convert.tf_static(Rig((place,)), 5), 5)
        for one in read.messages():
            log.write_raw(one.topic, one.msgtype, one.data, one.stamp)
    remaps = {f"{COLOUR}/image_raw": "/left/image_raw", f"{DEPTH}/image_rect_raw": "/left/depth/image_rect"}
    with LogSession(tmp_path / "log.mcap", remaps=remaps) as session:
        [camera] = session.rig.cameras
    assert camera.name == "left" and camera.depth_lens is not None
    assert (camera.K[0, 0], camera.depth_lens.K[0, 0]) == (64, 63)


@pytest.mark.parametrize(("late_ms", "is_told"), [(14, True), (3, False)])
def test_depth_that_belongs_to_no_image_is_told(tmp_path: Path, late_ms: int, is_told: bool) -> None:
    """Of a device whose two sensors keep no time with each other all depth was left out, and check found it sound."""
    lens = RigCamera("oak", 64, 48, np.array([[60.0, 0, 31.5], [0, 60, 23.5], [0, 0, 1]]), np.eye(4))
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write("/tf_static", convert.tf_static(Rig((lens,)), 5), 5)
        for at in range(0, 400_000_000, 40_000_000):
            image, depth = np.zeros((48, 64, 3), np.uint8), np.ones((48, 64), np.float32)
            log.write("/oak/camera_info", convert.camera_info(lens, at), at)
            log.write("/oak/image_raw", convert.raw_image("oak", at, image), at)
            late = at + late_ms * 1_000_000
            log.write("/oak/depth/image_rect", convert.depth_image("oak", late, depth), late)
    with open_log(tmp_path / "log.mcap") as log_read:
        told = [line for line in check_log(log_read).faults if "is stamped 14.0 ms from the images" in line]
    assert bool(told) == is_told
    with LogSession(tmp_path / "log.mcap") as session, warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        list(LogSource(session, SynchronizerParameters()))
    assert [str(one.message).partition(" images:")[0] for one in caught] == [
        "camera oak: depth with only 0 of its 10"
    ] * is_told


BENT, STRAIGHT = (-0.3, 0.1, 0.0, 0.0, 0.0), (0.0,) * 5


@pytest.mark.parametrize("name", ["image_raw", "image_rect"])
@pytest.mark.parametrize("depth_bends", [False, True])
@pytest.mark.parametrize("is_calibrated", [False, True])
def test_depth_is_that_of_its_own_lens(tmp_path: Path, name: str, depth_bends: bool, is_calibrated: bool) -> None:
    """depthai_ros aligns depth with the colour image without its distortion, librealsense with it; image_proc rectifies
    colour alone. The depth of each pixel tells its column, at 1 cm per pixel."""
    lens = RigCamera("camera_camera", 64, 48, np.array([[60.0, 0, 31.5], [0, 60, 23.5], [0, 0, 1]]), np.eye(4))
    columns = np.tile(np.arange(64, dtype=np.float32), (48, 1))
    if depth_bends:
        rays = np.stack(np.meshgrid((np.arange(64) - 31.5) / 60, (np.arange(48) - 23.5) / 60), -1).reshape(-1, 1, 2)
        plain = cv2.undistortPoints(rays * 60 + [31.5, 23.5], lens.K, np.array(BENT), P=lens.K)
        columns = plain.reshape(48, 64, 2)[..., 0].astype(np.float32)
    with LogWriter(tmp_path / "log.mcap") as log:
        log.write("/tf_static", convert.tf_static(Rig((lens,)), 5), 5)
        for folder, D in (("rgb", BENT), ("stereo", BENT if depth_bends else STRAIGHT)):
            info = convert.camera_info(replace(lens, D=np.array(D)), 5)
            log.write(f"/camera_camera/{folder}/camera_info", info, 5)
        image = convert.raw_image("camera_camera", 5, np.zeros((48, 64, 3), np.uint8))
        log.write(f"/camera_camera/rgb/{name}", image, 5)
        log.write("/camera_camera/stereo/image_raw", convert.depth_image("camera_camera", 5, 1 + columns / 100), 5)
    given = Rig((replace(lens, D=np.array(BENT if name == "image_raw" else STRAIGHT)),)) if is_calibrated else None
    with LogSession(tmp_path / "log.mcap", given) as session:
        [view] = next(iter(LogSource(session, SynchronizerParameters()))).views
    assert view.depth is not None
    known = view.depth[8:40, 8:56]
    np.testing.assert_allclose((known - 1) * 100, np.tile(np.arange(8, 56), (32, 1)), atol=0.8)


def log_of(path: Path, topics: dict[str, str], recorded: int = 5) -> Path:
    """One set of images on such topics: `rgb`, `16UC1`, or `png` for compressed depth; recorded at a time, ns."""
    frame = optical_frame("oak")
    made = {
        "rgb": convert.raw_image("oak", 5, np.zeros((48, 64, 3), np.uint8)),
        "16UC1": convert.depth_image("oak", 5, np.ones((48, 64), np.float32), "16UC1"),
        "32FC1": convert.depth_image("oak", 5, np.ones((48, 64), np.float32)),
        "png": convert.compressed_depth_image("oak", 5, np.ones((48, 64), np.float32)),
    }
    with LogWriter(path) as log:
        for topic, kind in topics.items():
            assert made[kind].header.frame_id == frame
            log.write(topic, made[kind], recorded)
    return path


@pytest.mark.parametrize(
    ("topic", "kind"), [("stereo/image_raw", "16UC1"), ("stereo/image_raw/compressedDepth", "png")]
)
def test_depth_whose_name_does_not_say_so_is_told_by_what_it_holds(tmp_path: Path, topic: str, kind: str) -> None:
    """depthai_ros has depth on `stereo`: it was taken for a colour camera, or compressed for nothing at all."""
    path = log_of(tmp_path / "log.mcap", {"/camera_camera/rgb/image_raw": "rgb", f"/camera_camera/{topic}": kind})
    with LogSession(path, rig_of(tmp_path / "rig.yaml")) as session:
        [camera] = session.cameras
        assert (camera.name, camera.depth, session.doubts) == ("camera_camera", f"/camera_camera/{topic}", ())


def test_depth_is_that_of_the_camera_it_was_brought_to(tmp_path: Path) -> None:
    """Azure's driver, without a namespace; of a ToF camera beside another camera nobody says so."""
    found = {
        camera.name: camera.depth
        for camera in find_cameras(
            dict.fromkeys(("/rgb/image_raw", "/depth_to_rgb/image_raw", "/a/rgb/image_raw", "/a/tof/depth/image"), RAW),
            "log",
        )
    }
    assert found == {"rgb": "/depth_to_rgb/image_raw", "a": None}


@pytest.mark.parametrize(
    ("topic", "kind"), [("/camera_camera/ir/image_raw", "16UC1"), ("/camera_camera/confidence/map", "32FC1")]
)
def test_what_is_neither_depth_nor_colour_is_left_out_and_told(tmp_path: Path, topic: str, kind: str) -> None:
    """Infrared images of 16 bits stopped the replay, or were taken for millimetres of depth."""
    path = log_of(tmp_path / "log.mcap", {"/camera_camera/rgb/image_raw": "rgb", topic: kind})
    with LogSession(path, rig_of(tmp_path / "rig.yaml")) as session:
        assert [(camera.name, camera.depth) for camera in session.cameras] == [("camera_camera", None)]
        assert session.doubts == (f"{topic} is left out: by its name neither depth nor colour, in {kind}",)


@pytest.mark.parametrize("is_alone", [True, False])
def test_a_camera_whose_images_are_of_a_type_that_is_not_read_is_told(tmp_path: Path, is_alone: bool) -> None:
    """Videos of image_transport and Foxglove: one camera fewer, and nobody said so."""
    path = tmp_path / "log.mcap"
    kind = "ffmpeg_image_transport_msgs/msg/FFMPEGPacket"
    with path.open("wb") as file, contextlib.ExitStack() as stack:
        writer = Writer(file)
        writer.start("ros2", "test")
        stack.callback(writer.finish)
        for topic, name, definition in (
            ("/left/image_raw/ffmpeg", kind, "uint8[] data"),
            *([] if is_alone else [("/camera_camera/image_raw", RAW, builtin_types().definition(RAW))]),
        ):
            channel = writer.register_channel(
                topic, "cdr", writer.register_schema(name, "ros2msg", definition.encode())
            )
            image = convert.raw_image("oak", 5, np.zeros((48, 64, 3), np.uint8))
            data = b"\0\1\0\0\0\0\0\0" if name == kind else bytes(serialize(image))
            writer.add_message(channel, 5, data, 5)
    line = f"/left/image_raw/ffmpeg is left out: expected sensor_msgs/CompressedImage or Image, found {kind}"
    if is_alone:
        with pytest.raises(GraphError, match=re.escape(line)):
            LogSession(path)
        return
    with LogSession(path, rig_of(tmp_path / "rig.yaml")) as session:
        assert session.doubts[0].startswith(line)


def test_depth_of_no_camera_is_named_with_what_makes_it_one(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Of a driver without a namespace all depth was left out without a word."""
    path = log_of(tmp_path / "log.mcap", {"/camera_camera/image_raw": "rgb", "/depth_to_rgb/image_raw": "16UC1"})
    rig = rig_of(tmp_path / "rig.yaml")
    with LogSession(path, rig) as session:
        [line] = session.doubts
    remap = line.split("--remap ")[1]
    assert line.startswith("/depth_to_rgb/image_raw is left out")
    with open_log(path) as log:
        assert line in check_log(log).faults
    with LogSession(path, rig, dict([remap.split(":=")])) as session:
        assert session.cameras[0].depth is not None and session.doubts == ()


def test_images_that_were_recorded_by_another_clock_than_stamped_are_named(tmp_path: Path) -> None:
    """A simulator's, recorded without --use-sim-time: the arm stood from first to last, and nobody said why."""
    path = log_of(tmp_path / "log.mcap", {"/camera_camera/image_raw": "rgb"}, recorded=1_700_000_000_000_000_000)
    with LogSession(path, rig_of(tmp_path / "rig.yaml")) as session:
        [line] = session.doubts
        assert not session.set_doubts  # that is nothing to whoever learns from it
    assert line.startswith("images are stamped 1700000000.0 s before they were recorded, by another clock")
