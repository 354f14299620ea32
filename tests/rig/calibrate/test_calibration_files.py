"""Boards, recordings and other tools' calibrations as files: what is read, and what every mistake is called."""

from __future__ import annotations

import json
import struct
import tempfile
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from hypothesis import given
from hypothesis import strategies as st
from simulated_boards import a_lens, around

from twin_node.errors import TwinError
from twin_node.geometry import inverse_pose, looking_at, quat_from_rotation
from twin_node.rig import RigError, load_rig, save_rig
from twin_node.rig.calibrate.april_grid import AprilGrid
from twin_node.rig.calibrate.board_files import find_board, load_board
from twin_node.rig.calibrate.boards import CharucoBoard, Chessboard, CircleGrid
from twin_node.rig.calibrate.camera_info import load_camera_info, save_camera_info
from twin_node.rig.calibrate.importers import IMPORTERS
from twin_node.rig.calibrate.recordings import load_cameras
from twin_node.scene import RigCamera


@pytest.mark.parametrize(
    ("text", "board"),
    [
        ("chessboard:9x6:0.025", Chessboard(9, 6, 0.025)),
        ("charuco:5x7:0.04:0.03:DICT_5X5_100", CharucoBoard(5, 7, 0.04, 0.03, "DICT_5X5_100")),
        ("aprilgrid:6x6:0.088:0.3", AprilGrid(6, 6, 0.088, 0.3)),
        ("acircles:4x11:0.02", CircleGrid(4, 11, 0.02, asymmetric=True)),
    ],
)
def test_boards_as_text(text: str, board: object) -> None:
    assert load_board(text) == board


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("charuco:12x12:0.04:0.03", "at most 50 markers, as many as DICT_4X4_50 has, found 72"),
        ("aprilgrid:30x30:0.02:0.3", "at most 587 markers, as many as DICT_APRILTAG_36h11 has, found 900"),
        ("chessboard:9x6", "expected chessboard:COLUMNSxROWS:SQUARE"),
        ("chessboard:2x5:0.03", "expected at least 3 columns and rows, found chessboard 2x5"),
        ("charuco:3x3:0.05:0.04", "expected at least 6 corners, found 4 of charuco 3x3"),
        ("acircles:7x3:0.02", "expected at least 4 rows and 10 dots, found asymmetric circles 7x3"),
        ("acircles:2x4:0.02", "expected at least 4 rows and 10 dots, found asymmetric circles 2x4"),
        ("aprilgrid:6x6:0.088:-0.3", "expected lengths above 0, found .* gaps of -0.3"),
        ("aprilgrid:6x6:0.088:0", "expected lengths above 0, found .* gaps of 0"),
        ("chessboard:9x6:inf", "expected lengths above 0, found .* squares of inf m"),
    ],
)
def test_boards_that_no_picture_can_hold_are_refused(text: str, words: str) -> None:
    """They were found in none, and nobody said why."""
    with pytest.raises(RigError, match=words):
        load_board(text)


@given(st.text(max_size=40))
def test_no_text_breaks_the_parser(text: str) -> None:
    for kind in ("chessboard:", "charuco:", "aprilgrid:", ""):
        try:
            load_board(kind + text)
        except TwinError as error:
            assert "\n" not in str(error)
        except (OSError, ValueError) as error:
            pytest.fail(f"{kind + text!r}: {error!r}")


def test_board_files_of_other_tools(tmp_path: Path) -> None:
    kalibr = {"target_type": "aprilgrid", "tagCols": 6, "tagRows": 5, "tagSize": 0.08, "tagSpacing": 0.3}
    (tmp_path / "april.yaml").write_text(yaml.safe_dump(kalibr))
    assert find_board(tmp_path) == AprilGrid(6, 5, 0.08, 0.3)
    (tmp_path / "board.yaml").write_text("kind: charuco\ncolumns: 6\nrows: 5\nsquare: 0.08\nmarker: 0.09\n")
    with pytest.raises(RigError, match="markers smaller than squares"):
        find_board(tmp_path)


def test_folders_without_recordings_are_refused(tmp_path: Path) -> None:
    board = Chessboard(9, 6, 0.025)
    with pytest.raises(RigError, match="one video per camera"):
        load_cameras(tmp_path, board)
    (tmp_path / "left.mp4").write_bytes(b"no video")
    with pytest.raises(RigError, match="stamps"):
        load_cameras(tmp_path, board)
    (tmp_path / "left.txt").write_text("0.0\n0.1\n")
    with pytest.raises(RigError, match="expected a video"):
        load_cameras(tmp_path, board)


@pytest.mark.parametrize(
    ("rows", "message"),
    [
        (b"0,0.0\n0,nan\n", "expected finite stamps"),
        (b"0,0.0\n0,inf\n", "expected finite stamps"),
        (b"0,0.0\n0\n", "expected a number as a stamp, found None"),
        (b"0,1700000000000\n", "expected stamps in s, found 1700000000000"),
        (b"0,\xe9\n", "expected stamps, found no readable file"),
        (b"1,0.0\n", "expected rows with cam_id 0"),
    ],
)
def test_shared_stamps_that_cannot_be_are_one_line(tmp_path: Path, rows: bytes, message: str) -> None:
    (tmp_path / "left.mp4").write_bytes(b"no video")
    (tmp_path / "timestamps.csv").write_bytes(b"cam_id,frame_time\n" + rows)
    with pytest.raises(RigError, match=message):
        load_cameras(tmp_path, Chessboard(9, 6, 0.025))


def test_a_board_in_millimetres_is_told() -> None:
    with pytest.raises(RigError, match=r"expected lengths in metres, found charuco .* squares of 28 m"):
        load_board("charuco:6x5:28:21")


def test_a_lens_that_cannot_be_written_leaves_what_stood_there(tmp_path: Path) -> None:
    path = tmp_path / "camera.yaml"
    save_camera_info(a_lens(), path)
    before = path.read_text()
    (tmp_path / "camera.yaml.partial").mkdir()
    with pytest.raises(RigError, match=r"camera\.yaml\.partial: exists already"):
        save_camera_info(a_lens(focal=600.0), path)
    assert path.read_text() == before


def test_stamps_in_milliseconds_are_told(tmp_path: Path) -> None:
    video = cv2.VideoWriter(str(tmp_path / "left.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 30, (64, 48))
    for _ in range(4):
        video.write(np.zeros((48, 64, 3), np.uint8))
    video.release()
    (tmp_path / "left.txt").write_text("0\n33\n67\n100\n")
    with pytest.raises(RigError, match=r"left.mp4: expected stamps in seconds, found 33 s"):
        load_cameras(tmp_path, Chessboard(9, 6, 0.025))


def test_every_third_frame_has_its_own_stamp(tmp_path: Path) -> None:
    video = cv2.VideoWriter(str(tmp_path / "left.mp4"), cv2.VideoWriter.fourcc(*"mp4v"), 30, (64, 48))
    for _ in range(7):
        video.write(np.zeros((48, 64, 3), np.uint8))
    video.release()
    (tmp_path / "left.txt").write_text("\n".join(str(0.1 * i) for i in range(7)))
    (left,) = load_cameras(tmp_path, Chessboard(9, 6, 0.025), every=3)
    np.testing.assert_allclose(left.stamps, [0, 3e8, 6e8], atol=1)
    assert left.images == tuple(f"left.mp4 frame {i}" for i in (0, 3, 6))
    (tmp_path / "left.txt").write_text("\n".join(str(0.1 * i) for i in range(9)))  # as many at every third place
    with pytest.raises(RigError, match="one stamp for each of its 7 frames, found 9"):
        load_cameras(tmp_path, Chessboard(9, 6, 0.025), every=3)


@pytest.mark.parametrize(("one", "other"), [("left1", "left_01"), ("left/a_1", "left/b_1")])
def test_pictures_of_one_camera_that_have_one_number_are_refused(tmp_path: Path, one: str, other: str) -> None:
    """One of them was lost, in silence."""
    (tmp_path / "left").mkdir()
    for name in (one, other):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.zeros((48, 64), np.uint8))
    with pytest.raises(RigError, match=r"png: expected images of one camera with distinct numbers, found that of .*1"):
        load_cameras(tmp_path, Chessboard(9, 6, 0.025))


def test_pictures_of_different_sizes_are_refused(tmp_path: Path) -> None:
    for number, width in ((1, 64), (2, 80)):
        cv2.imwrite(str(tmp_path / f"left{number}.png"), np.zeros((48, width), np.uint8))
    with pytest.raises(RigError, match="one size"):
        load_cameras(tmp_path, Chessboard(9, 6, 0.025))


@pytest.mark.parametrize("step", [1, 1_000_123, 10**11])
def test_pictures_named_by_times_belong_together_in_their_order(tmp_path: Path, step: int) -> None:
    """Dates to the microsecond have 20 digits, nanoseconds since 1970 have 19: neither can be counted in seconds."""
    first = 20251126042312345678
    for camera, numbers in (("left", (0, 1, 3)), ("right", (1, 2, 3))):
        for number in numbers:
            cv2.imwrite(str(tmp_path / f"{camera}_{first + number * step}.png"), np.zeros((48, 64), np.uint8))
    left, right = load_cameras(tmp_path, Chessboard(9, 6, 0.025))
    assert (left.stamps // 10**9).tolist() == [0, 1, 3]
    assert (right.stamps // 10**9).tolist() == [1, 2, 3]


@pytest.mark.parametrize("form", ["{camera}/{time}.png", "{camera}_{time}.png"])
def test_pictures_named_by_seconds_with_a_fraction_are_told_apart(tmp_path: Path, form: str) -> None:
    """As exports of bags are named: the fraction alone was the number, so that of two seconds' images one was left."""
    for camera, seconds in (("left", (0, 1, 3)), ("right", (1, 2, 3))):
        (tmp_path / camera).mkdir()
        for second in seconds:
            path = tmp_path / form.format(camera=camera, time=f"{1_700_000_000 + second}.033333")
            cv2.imwrite(str(path), np.zeros((48, 64), np.uint8))
    left, right = load_cameras(tmp_path, Chessboard(9, 6, 0.025))
    assert (left.name, right.name) == ("left", "right")
    assert [(camera.stamps // 10**9).tolist() for camera in (left, right)] == [[0, 1, 3], [1, 2, 3]]


def test_pictures_may_have_a_point_before_their_number(tmp_path: Path) -> None:
    for name in ("left.0001", "left.0002", "right.0002"):
        cv2.imwrite(str(tmp_path / f"{name}.png"), np.zeros((48, 64), np.uint8))
    left, right = load_cameras(tmp_path, Chessboard(9, 6, 0.025))
    assert [(camera.stamps // 10**9).tolist() for camera in (left, right)] == [[1, 2], [2]]


def test_camera_info_is_read_back(tmp_path: Path) -> None:
    lens = a_lens("equidistant")
    save_camera_info(lens, tmp_path / "left.yaml")
    again = load_camera_info(tmp_path / "left.yaml").lens
    np.testing.assert_array_equal(again.parameters, lens.parameters)
    assert (again.width, again.height, again.distortion_model) == (640, 480, "equidistant")


def test_a_kalibr_chain_becomes_a_rig(tmp_path: Path) -> None:
    poses, chain = around(3), {}
    for i, T in enumerate(poses):
        camera = {
            "camera_model": "pinhole",
            "intrinsics": [500.0, 501.0, 320.0, 240.0],
            "distortion_model": "radtan",
            "distortion_coeffs": [0.1, -0.05, 0.001, 0.002],
            "resolution": [640, 480],
        }
        if i:
            camera["T_cn_cnm1"] = (inverse_pose(T) @ poses[i - 1]).tolist()
        chain[f"cam{i}"] = camera
    (tmp_path / "camchain.yaml").write_text(yaml.safe_dump(chain))
    cameras = IMPORTERS["kalibr"](tmp_path / "camchain.yaml", 1.0).rig.cameras
    for camera, T in zip(cameras, poses, strict=True):
        np.testing.assert_allclose(camera.T_base_cam, inverse_pose(poses[0]) @ T, atol=1e-12)


def test_a_colmap_model_becomes_a_rig(tmp_path: Path) -> None:
    (tmp_path / "cameras.txt").write_text("# cameras\n1 OPENCV 640 480 500 501 320.5 240.5 0.1 -0.05 0.001 0.002\n")
    lines = ["# images"]
    for i, T in enumerate(around(3)):
        world_to_camera = inverse_pose(T)
        numbers = [*quat_from_rotation(world_to_camera[:3, :3]), *world_to_camera[:3, 3]]
        lines += [f"{i + 1} {' '.join(map(str, numbers))} 1 view{i}.png", ""]
    (tmp_path / "images.txt").write_text("\n".join(lines) + "\n")
    cameras = IMPORTERS["colmap"](tmp_path, 0.5).rig.cameras
    for camera, T in zip(cameras, around(3), strict=True):
        np.testing.assert_allclose(camera.T_base_cam[:3, :3], T[:3, :3], atol=1e-9)
        np.testing.assert_allclose(camera.T_base_cam[:3, 3], 0.5 * T[:3, 3], atol=1e-9)
        np.testing.assert_allclose(camera.K[:2, 2], [320, 240])  # COLMAP's pixel centres are at halves


def colmap_binary(folder: Path, model: int, parameters: list[float], poses: list[np.ndarray]) -> None:
    """A model as COLMAP writes it, each image with three points."""
    lens = struct.pack("<QiiQQ", 1, 7, model, 640, 480) + struct.pack(f"<{len(parameters)}d", *parameters)
    (folder / "cameras.bin").write_bytes(lens)
    images = struct.pack("<Q", len(poses))
    for i, T in enumerate(poses):
        world_to_camera = inverse_pose(T)
        numbers = [*quat_from_rotation(world_to_camera[:3, :3]), *world_to_camera[:3, 3]]
        images += struct.pack("<i7di", i + 1, *numbers, 7) + f"view{i}.png".encode() + b"\0"
        images += struct.pack("<Q", 3) + struct.pack("<ddq", 1.0, 2.0, -1) * 3
    (folder / "images.bin").write_bytes(images)


def test_a_binary_colmap_model_is_read_as_the_text_is(tmp_path: Path) -> None:
    colmap_binary(tmp_path, 4, [500, 501, 320.5, 240.5, 0.1, -0.05, 0.001, 0.002], around(3))
    cameras = IMPORTERS["colmap"](tmp_path, 0.5).rig.cameras
    assert [camera.name for camera in cameras] == ["view0", "view1", "view2"]
    for camera, T in zip(cameras, around(3), strict=True):
        np.testing.assert_allclose(camera.T_base_cam[:3, :3], T[:3, :3], atol=1e-9)
        np.testing.assert_allclose(camera.T_base_cam[:3, 3], 0.5 * T[:3, 3], atol=1e-9)
        np.testing.assert_allclose(camera.K[:2, 2], [320, 240])
        np.testing.assert_allclose(camera.D, [0.1, -0.05, 0.001, 0.002, 0])


@pytest.mark.parametrize(("number", "name", "parameters"), [(7, "FOV", 5), (11, "RAD_TAN_THIN_PRISM_FISHEYE", 16)])
def test_colmap_lenses_without_a_counterpart_are_named(tmp_path: Path, number: int, name: str, parameters: int) -> None:
    colmap_binary(tmp_path, number, [500, 501, 320.5, 240.5, *[0.1] * (parameters - 4)], around(2))
    with pytest.raises(RigError, match=f"found {name}; undistort"):
        IMPORTERS["colmap"](tmp_path, 1.0)


@pytest.mark.parametrize("file", ["cameras.bin", "images.bin"])
def test_a_count_of_colmap_that_is_too_small_is_named(tmp_path: Path, file: str) -> None:
    """Cameras behind it were left out in silence."""
    colmap_binary(tmp_path, 1, [500, 501, 320.5, 240.5], around(3))
    whole = (tmp_path / file).read_bytes()
    count = int.from_bytes(whole[:8], "little") - 1
    (tmp_path / file).write_bytes(count.to_bytes(8, "little") + whole[8:])
    with pytest.raises(RigError, match=rf"{file}: .* found [0-9]+ bytes behind the {count} that it counts"):
        IMPORTERS["colmap"](tmp_path)


@given(st.integers(0, 400), st.binary(max_size=8))
def test_binary_colmap_models_cut_short_are_refused(kept: int, tail: bytes) -> None:
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        colmap_binary(folder, 4, [500, 501, 320.5, 240.5, 0.1, -0.05, 0.001, 0.002], around(3))
        for file in ("cameras.bin", "images.bin"):
            whole = (folder / file).read_bytes()
            (folder / file).write_bytes(whole[:kept] + tail if kept < len(whole) else whole)
        try:
            IMPORTERS["colmap"](folder, 1.0)
        except TwinError as error:
            assert "\n" not in str(error)


def test_files_of_real_tools_become_the_rigs_that_are_known(recordings: Path) -> None:
    walker = load_rig("calibration/walker_4cam.yaml").rig
    imported = {
        "opencv": recordings / "walker_4cam" / "calib_opencv.json",
        "qualisys": recordings / "walker_4cam" / "Calib.qca.txt",
        "toml": recordings / "walker_4cam" / "Calib_qualisys.toml",
    }
    for kind, path in imported.items():
        cameras = IMPORTERS[kind](path).rig.cameras
        assert len(cameras) == len(walker.cameras)
        apart = distances(cameras)
        np.testing.assert_allclose(apart, distances(walker.cameras), rtol=0.02)


def test_a_unit_of_a_metre_is_taken_for_one(recordings: Path) -> None:
    path = recordings / "walker_4cam" / "Calib.qca.txt"
    with pytest.raises(RigError, match="expected a translation in metres"):
        IMPORTERS["qualisys"](path, 1.0)


def distances(cameras: tuple[RigCamera, ...]) -> np.ndarray:
    """Between all pairs of cameras, m, in rising order: what no choice of frame or order changes."""
    centres = np.stack([camera.T_base_cam[:3, 3] for camera in cameras])
    return np.sort(np.linalg.norm(centres[:, None] - centres, axis=2)[np.triu_indices(len(centres), 1)])


def test_an_imported_rig_is_written_and_read_back(recordings: Path, tmp_path: Path) -> None:
    rig_file = IMPORTERS["toml"](recordings / "charuco_4cam" / "camera_array.toml", 1.0)
    save_rig(rig_file, tmp_path / "rig.yaml")
    for before, after in zip(rig_file.rig.cameras, load_rig(tmp_path / "rig.yaml").rig.cameras, strict=True):
        np.testing.assert_allclose(after.T_base_cam, before.T_base_cam, atol=1e-12)
        np.testing.assert_allclose(after.K, before.K)
        np.testing.assert_allclose(after.D, before.D)


@pytest.mark.parametrize("kind", sorted(IMPORTERS))
def test_wrong_files_get_one_clear_line(kind: str, tmp_path: Path) -> None:
    wrong = tmp_path / "wrong.txt"
    wrong.write_text("neither this: [nor that")
    for path in (wrong, tmp_path / "missing.json"):
        with pytest.raises(TwinError, match="expected") as caught:
            IMPORTERS[kind](path, 1.0)
        assert "\n" not in str(caught.value)


FISHEYE = np.array([-0.02, 0.01, -0.005, 0.001])
PINHOLE = np.array([[500.0, 0, 640], [0, 500, 480], [0, 0, 1]])


def test_opencvs_fisheye_lenses_are_told_from_others(tmp_path: Path) -> None:
    """Both have four coefficients."""
    path = tmp_path / "left.yaml"
    for is_fisheye, model in ((1, "equidistant"), (0, "plumb_bob")):
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
        for key, number in (("image_width", 1280), ("image_height", 960), ("fisheye_model", is_fisheye)):
            storage.write(key, number)
        storage.write("camera_matrix", PINHOLE)
        storage.write("distortion_coefficients", FISHEYE[:, None])
        storage.release()
        assert IMPORTERS["opencv"](path).rig.cameras[0].distortion_model == model
        R_t = {"R": np.eye(3).tolist(), "t": [0, 0, 1]}
        lens = {"K": PINHOLE.tolist(), "dist": FISHEYE.tolist(), "fisheye": bool(is_fisheye)}
        listed = {"cameras": [{"name": "left", "size": [1280, 960], **lens, **R_t}]}
        path.with_suffix(".json").write_text(json.dumps(listed))
        assert IMPORTERS["opencv"](path.with_suffix(".json")).rig.cameras[0].distortion_model == model


def test_a_projection_of_zeros_is_one_that_nobody_told(tmp_path: Path) -> None:
    path = tmp_path / "left.yaml"
    save_camera_info(a_lens(), path)
    content = yaml.safe_load(path.read_text())
    for key in ("projection_matrix", "rectification_matrix"):
        content[key]["data"] = [0.0] * len(content[key]["data"])
    path.write_text(yaml.safe_dump(content))
    np.testing.assert_array_equal(IMPORTERS["camera_info"](path).rig.cameras[0].T_base_cam, np.eye(4))
    content["projection_matrix"]["data"][0] = 500.0
    path.write_text(yaml.safe_dump(content))
    with pytest.raises(RigError, match=r"left\.yaml\.projection_matrix: expected .* of full rank"):
        load_camera_info(path)


def test_cameras_without_end_are_one_line(tmp_path: Path) -> None:
    path = tmp_path / "cameras.json"
    path.write_text("[" * 100_000)
    with pytest.raises(RigError, match=r"cameras\.json: expected cameras in JSON, found: too many levels"):
        IMPORTERS["opencv"](path, 1.0)


def test_transposed_rotations_are_named_by_the_file_alone(tmp_path: Path) -> None:
    cameras = []
    for i, centre in enumerate(([0.5, -0.9, 0.4], [-1.9, 1.3, 1.9], [0.4, 0.9, 1.2])):
        T = looking_at(np.array(centre), np.array([0.1, 0.0, 0.0]))
        wrong = T.copy()
        wrong[:3, :3] = T[:3, :3].T
        K = [[500.0, 0.0, 320.0], [0.0, 500.0, 240.0], [0.0, 0.0, 1.0]]
        cameras.append({"name": f"cam{i}", "size": [640, 480], "K": K, "T_base_cam": wrong.tolist()})
    (tmp_path / "rig.yaml").write_text(yaml.safe_dump({"cameras": cameras}))
    with pytest.raises(RigError, match="transpose each"):
        load_rig(tmp_path / "rig.yaml")
