"""Units, clocks and rectified frames of other tools' calibrations: what is read is what was written."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
import pytest
import yaml
from simulated_boards import around

from twin_node.geometry import inverse_pose, transform
from twin_node.rig.calibrate.importers import IMPORTERS
from twin_node.scene import Float64

K = [[500.0, 0.0, 320.0], [0.0, 501.0, 240.0], [0.0, 0.0, 1.0]]
UNIT_M = 0.01


def in_units(T: Float64) -> Float64:
    """[4, 4] the pose as a file in centimetres has it."""
    out: Float64 = T.copy()
    out[:3, 3] /= UNIT_M
    return out


def kalibr(path: Path, poses: Float64) -> None:
    chain = {}
    for i, T in enumerate(poses):
        lens = {"distortion_model": "radtan", "distortion_coeffs": [0.1, 0.0, 0.0, 0.0]}
        camera = {
            "camera_model": "pinhole",
            "intrinsics": [500.0, 501.0, 320.0, 240.0],
            "resolution": [640, 480],
            **lens,
        }
        next_last = {"T_cn_cnm1": in_units(inverse_pose(T) @ poses[i - 1]).tolist()} if i else {}
        chain[f"cam{i}"] = {**camera, **next_last, "timeshift_cam_imu": 0.02 * i}
    path.write_text(yaml.safe_dump(chain))


def opencv(path: Path, poses: Float64) -> None:
    views = [in_units(inverse_pose(T)) for T in poses]
    cameras = [
        {"name": f"cam{i}", "size": [640, 480], "K": K, "dist": [0.1], "R": V[:3, :3].tolist(), "t": V[:3, 3].tolist()}
        for i, V in enumerate(views)
    ]
    path.write_text(json.dumps({"cameras": cameras}))


def stereo(path: Path, poses: Float64) -> None:
    storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
    right = in_units(inverse_pose(poses[1]) @ poses[0])
    for key in ("1", "2"):
        storage.write(f"M{key}", np.array(K))
        storage.write(f"D{key}", np.array([[0.1, 0.0, 0.0, 0.0, 0.0]]))
    storage.write("R", np.ascontiguousarray(right[:3, :3]))
    storage.write("T", np.ascontiguousarray(right[:3, 3:]))
    storage.write("size", np.array([640, 480]))
    storage.release()


def toml(path: Path, poses: Float64) -> None:
    tables = [
        f"[cam_{i}]\nsize = [640, 480]\nmatrix = {K}\ndistortions = [0.1, 0.0, 0.0, 0.0]\n"
        f"rotation = {V[:3, :3].tolist()}\ntranslation = {V[:3, 3].tolist()}\n"
        for i, V in enumerate(in_units(inverse_pose(T)) for T in poses)
    ]
    path.write_text("".join(tables))


@pytest.mark.parametrize(
    ("kind", "name", "write"),
    [
        ("kalibr", "camchain.yaml", kalibr),
        ("opencv", "rig.json", opencv),
        ("opencv", "stereo.yml", stereo),
        ("toml", "rig.toml", toml),
    ],
)
def test_lengths_are_in_the_unit_given(kind: str, name: str, write: object, tmp_path: Path) -> None:
    poses = np.stack(around(2))
    assert callable(write)
    write(tmp_path / name, poses)
    cameras = IMPORTERS[kind](tmp_path / name, UNIT_M).rig.cameras
    between = inverse_pose(cameras[0].T_base_cam) @ cameras[1].T_base_cam
    np.testing.assert_allclose(between, inverse_pose(poses[0]) @ poses[1], atol=1e-9)


def test_kalibrs_time_shift_is_added_to_a_cameras_stamps(tmp_path: Path) -> None:
    """As its documentation has it: t_imu = t_cam + shift."""
    kalibr(tmp_path / "camchain.yaml", np.stack(around(2)))
    left, right = IMPORTERS["kalibr"](tmp_path / "camchain.yaml", UNIT_M).rig.cameras
    assert (left.rig_time(10**9), right.rig_time(10**9)) == (10**9, 1_020_000_000)


def test_a_rectified_pair_of_ros_stands_as_opencv_rectified_it(tmp_path: Path) -> None:
    """A point that both see in different places is one point in the rig's frame, the first rectified one."""
    turn, _ = cv2.Rodrigues(np.array([0.02, -0.1, 0.05]))
    shift = np.array([[-20.0], [0.5], [1.0]])  # cm
    none, size = np.zeros(5), (640, 480)
    R1, R2, P1, P2, *_ = cv2.stereoRectify(np.array(K), none, np.array(K), none, size, turn, shift)
    for name, R, P in (("left", R1, P1), ("right", R2, P2)):
        tables = {"camera_matrix": np.array(K), "rectification_matrix": R, "projection_matrix": P}
        info = {key: {"data": np.ravel(value).tolist()} for key, value in tables.items()}
        lens = {"distortion_model": "plumb_bob", "distortion_coefficients": {"data": none.tolist()}}
        (tmp_path / f"{name}.yaml").write_text(
            yaml.safe_dump({"image_width": 640, "image_height": 480, **info, **lens})
        )
    (tmp_path / "._left.yaml").write_bytes(b"\0\5\x16\7")  # macOS leaves such beside what it copies
    left, right = IMPORTERS["camera_info"](tmp_path, UNIT_M).rig.cameras
    points = np.array([[0.1, 0.2, 1.5], [-0.3, 0.0, 2.0]])  # m, as the left camera sees them
    seen = points @ np.asarray(turn).T + UNIT_M * shift.T
    np.testing.assert_allclose(transform(left.T_base_cam, points), transform(right.T_base_cam, seen), atol=1e-9)
    np.testing.assert_allclose(transform(left.T_base_cam, points), points @ np.asarray(R1).T, atol=1e-9)
