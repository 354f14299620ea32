"""Calibrations as other tools write them: arrays of their own shapes, zeros left out or added, folders as names."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import yaml
from simulated_boards import a_lens

from twin_node.rig import RigError
from twin_node.rig.calibrate.camera_info import load_camera_info, save_camera_info
from twin_node.rig.calibrate.importers import IMPORTERS
from twin_node.rig.rig_checks import aims_off, whole_coefficients

K = [[500.0, 0, 320], [0, 500, 240], [0, 0, 1]]
EIGHT = [0.3, 0.1, 0.001, 0.001, 0.01, 0.5, 0.1, 0.02]


@pytest.mark.parametrize(
    ("dist", "model", "coefficients"),
    [
        ([[0.1, 0.2, 0, 0, 0.3]], "plumb_bob", [0.1, 0.2, 0, 0, 0.3]),
        ([[0.1], [0.2], [0], [0], [0.3]], "plumb_bob", [0.1, 0.2, 0, 0, 0.3]),
        ([[0.1, 0.2, 0, 0, 0.3] + 9 * [0]], "plumb_bob", [0.1, 0.2, 0, 0, 0.3]),
        (EIGHT + 6 * [0], "rational_polynomial", EIGHT),
    ],
)
def test_arrays_of_opencv_are_read_as_it_returns_them(
    tmp_path: Path, dist: list[object], model: str, coefficients: list[float]
) -> None:
    camera = {"name": "left", "size": [640, 480], "K": K, "dist": dist, "R": np.eye(3).tolist(), "t": [[0], [0], [1]]}
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps({"cameras": [camera]}))
    (found,) = IMPORTERS["opencv"](path).rig.cameras
    assert (found.distortion_model, found.D.tolist()) == (model, coefficients)
    assert found.T_base_cam[:3, 3].tolist() == [0, 0, -1]


def test_coefficients_that_no_lens_here_has_are_refused(tmp_path: Path) -> None:
    """Thin prisms: leaving them out would be another lens."""
    camera = {"name": "left", "size": [640, 480], "K": K, "dist": [*EIGHT, 0.01, 0, 0, 0], "R": np.eye(3).tolist()}
    path = tmp_path / "cameras.json"
    path.write_text(json.dumps({"cameras": [{**camera, "t": [0, 0, 1]}]}))
    with pytest.raises(RigError, match="expected 8 numbers for rational_polynomial, found 12"):
        IMPORTERS["opencv"](path)
    assert whole_coefficients("fov", np.ones(1)).tolist() == [1.0]


def test_camera_info_of_a_driver_that_tells_no_distortion(tmp_path: Path) -> None:
    path = tmp_path / "left.yaml"
    save_camera_info(a_lens(), path)
    content = yaml.safe_load(path.read_text())
    for model in ("", "plumb_bob", "equidistant"):
        content["distortion_model"], content["distortion_coefficients"] = model, {"rows": 1, "cols": 0, "data": []}
        path.write_text(yaml.safe_dump(content))
        lens = load_camera_info(path).lens
        assert (lens.distortion_model, lens.D.tolist()) == ("plumb_bob", [0.0] * 5)


@pytest.mark.parametrize("size", ["image_width: 640.5\nimage_height: 480", "image_width: 640\nimage_height: -480"])
def test_camera_info_of_a_size_that_no_image_has(tmp_path: Path, size: str) -> None:
    path = tmp_path / "left.yaml"
    K = "camera_matrix: {rows: 3, cols: 3, data: [500, 0, 320, 0, 500, 240, 0, 0, 1]}"
    path.write_text(f"{size}\n{K}\ndistortion_model: plumb_bob\ndistortion_coefficients: {{data: [0, 0, 0, 0, 0]}}\n")
    with pytest.raises(RigError, match=r"left\.yaml\.size: expected \[width, height\] in whole pixels"):
        IMPORTERS["camera_info"](path)


def test_images_numbered_alike_in_a_folder_per_camera_are_named_after_both(tmp_path: Path) -> None:
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 640 480 500 500 320 240\n")
    poses = [f"{i} 1 0 0 0 {i} 0 0 1 {name}/0001.png\n\n" for i, name in enumerate(("left", "right"))]
    (tmp_path / "images.txt").write_text("".join(poses))
    assert [camera.name for camera in IMPORTERS["colmap"](tmp_path).rig.cameras] == ["left_0001", "right_0001"]


@pytest.mark.parametrize("name", ["/", "."])
def test_images_without_names_are_refused_as_cameras_of_one_name(tmp_path: Path, name: str) -> None:
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 640 480 500 500 320 240\n")
    (tmp_path / "images.txt").write_text("".join(f"{i} 1 0 0 0 {i} 0 0 1 {name}\n\n" for i in range(2)))
    with pytest.raises(RigError, match="expected cameras with distinct names, found 'cam_' 2 times"):
        IMPORTERS["colmap"](tmp_path)


def stereo_file(path: Path, **replaced: str) -> Path:
    """A pair as OpenCV's FileStorage has it, its size written as `cv::Size`, its coefficients as a vector."""

    def matrix(values: object) -> str:
        rows = np.atleast_2d(np.array(values, np.float64))
        shape = f"rows: {rows.shape[0]}, cols: {rows.shape[1]}"
        return f"!!opencv-matrix\n   {{ {shape}, dt: d, data: {rows.ravel().tolist()} }}"

    D, R, T = "[0.1, 0., 0., 0., 0.]", matrix(np.eye(3)), matrix([[-0.1], [0], [0]])
    fields = {"size": "[ 640, 480 ]", "M1": matrix(K), "D1": D, "M2": matrix(K), "D2": D, "R": R, "T": T, **replaced}
    path.write_text("%YAML:1.0\n---\n" + "".join(f"{name}: {value}\n" for name, value in fields.items()))
    return path


def test_sizes_and_vectors_are_read_as_opencv_writes_them(tmp_path: Path) -> None:
    """They are sequences and no matrices, and ended in a traceback."""
    left, right = IMPORTERS["opencv"](stereo_file(tmp_path / "stereo.yml")).rig.cameras
    assert (left.width, left.height, left.D.tolist()) == (640, 480, [0.1, 0, 0, 0, 0])
    assert right.T_base_cam[:3, 3].tolist() == [0.1, 0, 0]


@pytest.mark.parametrize(
    ("replaced", "told"),
    [
        ({"M1": "5"}, r"stereo\.yml: expected 3x3 finite numbers as 'M1', found one number"),
        ({"M1": "[1, 2, 3]"}, r"stereo\.yml: expected 3x3 finite numbers as 'M1', found 3"),
        ({"size": "[wide, high]"}, r"stereo\.yml: expected 2 finite numbers as 'size', found something else"),
        ({"size": "[640.5, 480]"}, r"left\.size: expected \[width, height\] in whole pixels"),
        ({"size": "[-5, 480]"}, r"left\.size: expected \[width, height\] in whole pixels, up to 32767, found \[-5"),
        ({"D2": "[.Nan, 0., 0., 0.]"}, r"stereo\.yml: expected finite numbers as 'D2', found \[nan, "),
    ],
)
def test_what_no_calibration_of_opencv_holds_is_named(tmp_path: Path, replaced: dict[str, str], told: str) -> None:
    with pytest.raises(RigError, match=told):
        IMPORTERS["opencv"](stereo_file(tmp_path / "stereo.yml", **replaced))


@pytest.mark.parametrize(
    ("cameras", "images", "told"),
    [
        ("1 PINHOLE nan 480 5 5 320 240", "1 1 0 0 0 0 0 1 1 a.png\n", "camera 1: expected finite numbers"),
        ("1 PINHOLE 640 480 500 500 320 240", "1 nan 0 0 0 0 0 1 1 a.png\n", r"a\.png: expected finite numbers"),
        ("1 PINHOLE 640 480 500 500 320 240", "1 0 0 0 0 0 0 1 1 a.png\n", r"a\.png: expected a quaternion, found"),
        (
            "1 PINHOLE 640 480 500 500 320 240",
            "1 1 0 0 0 0 0 1 1 a.png\n2 1 0 0 0 1 0 1 1 b.png\n",
            r"a\.png: expected a line of points below it, empty where there are none, found '2 1 0 0 0 1 0 1 1 b\.png'",
        ),
        ("1 PINHOLE 640 480 500 500 320 240", "1 1 0 0 0 0 0 1 1 a.png\n\n2 1 0 0 0", "and a name, found '2 1 0 0 0'"),
        ("1 PINHOLE 640.5 480 500 500 320 240", "1 1 0 0 0 0 0 1 1 a.png\n", r"a\.png\.size: expected .* whole pixels"),
        (
            "1 PINHOLE 640 480 500 500 320 240",
            "1 1 0 0 0 0 0 1 1 a.png\n2 1 0 0 0 1 0 1 1 the left one.png\n",
            r"a\.png: expected a line of points below it, .* found '2 1 0 0 0 1 0 1 1 the left one\.png'",
        ),
        (
            "1 PINHOLE 640 480 500 500 320 240",
            "1 1 0 0 0 0 0 1 1.5 a.png\n",
            r"a\.png: expected the number of a camera, found '1\.5'",
        ),
        (
            "1 PINHOLE 640 480 500 500 320 240\n1 PINHOLE 480 640 500 500 240 320",
            "1 1 0 0 0 0 0 1 1 a.png\n",
            r"cameras\.txt: camera 1: expected number 1 once, found it again",
        ),
        (
            "1 PINHOLE 640 480 500 500 320 240",
            "1 1 0 0 0 0 0 1 1 a.png\n\n1 1 0 0 0 1 0 1 1 b.png\n",
            r"b\.png: expected number 1 once, found it again",
        ),
        (f"1 PINHOLE {'9' * 5000} 480 5 5 320 240", "", "camera 1: expected finite numbers, found 9{60}$"),
    ],
)
def test_what_no_colmap_model_holds_is_named(tmp_path: Path, cameras: str, images: str, told: str) -> None:
    """Written as NaN into the rig, or ended in a traceback; without the lines of points every second image was lost."""
    (tmp_path / "cameras.txt").write_text(f"{cameras}\n")
    (tmp_path / "images.txt").write_text(images)
    with pytest.raises(RigError, match=told):
        IMPORTERS["colmap"](tmp_path)


@pytest.mark.parametrize("mark", ["", "\ufeff"])
def test_empty_lines_and_comments_lose_no_image(tmp_path: Path, mark: str) -> None:
    """As COLMAP reads them: a second empty line shifted all below it, and they were left out in silence."""
    (tmp_path / "cameras.txt").write_text(f"{mark}# Cameras\n\n  # of one\n1 PINHOLE 640 480 500 500 320 240\n")
    images = [f"{i} 1 0 0 0 {i} 0 1 1 {name}.png\n" for i, name in enumerate("abc")]
    (tmp_path / "images.txt").write_text(
        f"{mark}# Images\n\n{images[0]}\n\n  # the second\n{images[1]}1.5 2.5 -1\n\n\n{images[2]}"
    )
    assert [camera.name for camera in IMPORTERS["colmap"](tmp_path).rig.cameras] == ["a", "b", "c"]


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("length", ["1e-300", "1e300"])
def test_quaternions_whose_squares_have_no_end_are_rotations(tmp_path: Path, length: str) -> None:
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 640 480 500 500 320 240\n")
    (tmp_path / "images.txt").write_text(f"1 {length} 0 {length} 0 0 0 0 1 a.png\n\n")
    (camera,) = IMPORTERS["colmap"](tmp_path).rig.cameras
    np.testing.assert_allclose(camera.T_base_cam[:3, :3], [[0, 0, -1], [0, 1, 0], [1, 0, 0]], atol=1e-12)


@pytest.mark.filterwarnings("error")
def test_numbers_without_end_are_one_error(tmp_path: Path) -> None:
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 640 480 500 500 1e308 240\n")
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0 0 1e200 1 a.png\n\n")
    with pytest.raises(RigError, match=r"found \(1e\+308, 239\.5\)"):
        IMPORTERS["colmap"](tmp_path)
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 640 480 500 500 320 240\n")
    with pytest.raises(RigError, match=r"expected a translation in metres, .* 1e\+200 m from the base"):
        IMPORTERS["colmap"](tmp_path)


def test_numbers_of_qualisys_that_are_none_are_named(tmp_path: Path) -> None:
    path = tmp_path / "calibration.qca.txt"
    path.write_text(
        '<calibration><cameras><camera serial="1"><transform/><intrinsic/><fov_video left="0" top="0" right="nan" '
        'bottom="479"/></camera></cameras></calibration>'
    )
    with pytest.raises(RigError, match=r"expected a number in fov_video\.right, found 'nan'"):
        IMPORTERS["qualisys"](path)


TABLE = (
    f"[cam_0]\nsize = [640, 480]\nmatrix = {K}\ndistortions = [0.1]\nrotation = [0, 0, 0]\ntranslation = [0, 0, 1]\n"
)


@pytest.mark.parametrize(
    ("right", "wrong", "told"),
    [
        ("640, 480", "640.5, 480", r"cam_0\.size: expected \[width, height\] in whole pixels"),
        ("rotation = [0, 0, 0]", "rotation = [nan, 0, 0]", r"cam_0\.rotation: expected finite numbers"),
        ("rotation = [0, 0, 0]", f"rotation = {5000 * '9'}", "expected a calibration in TOML, found"),
        ("rotation = [0, 0, 0]", f"rotation = {5000 * '['}", "expected a calibration in TOML, found: too many levels"),
        ("rotation = [0, 0, 0]", f"rotation = 0x{5000 * 'f'}", "rotation: expected .* found a number of thousands"),
        ("rotation = [0, 0, 0]", "rotation = [[1, 0], [0, 1]]", r"cam_0\.rotation: expected 3x3 numbers, found 2x2"),
    ],
)
def test_what_no_table_of_toml_holds_is_named(tmp_path: Path, right: str, wrong: str, told: str) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(TABLE.replace(right, wrong))
    with pytest.raises(RigError, match=told):
        IMPORTERS["toml"](path)


@pytest.mark.parametrize(
    ("change", "told"),
    [
        ({"cam1": None}, r"camchain\.yaml: expected cam1 before cam2, found none"),
        ({"timeshift_cam_imu": 1e300}, r"cam0\.timeshift_cam_imu: expected seconds, found 1e\+300"),
        ({"resolution": [640.5, 480]}, r"cam0\.size: expected \[width, height\] in whole pixels"),
    ],
)
def test_what_no_chain_of_kalibr_holds_is_named(tmp_path: Path, change: dict[str, object], told: str) -> None:
    """Cameras behind a gap were left out in silence; a shift without end was a traceback."""
    camera = {"camera_model": "pinhole", "distortion_model": "none", "intrinsics": [500, 500, 320, 240]}
    camera |= {"resolution": [640, 480], "T_cn_cnm1": np.eye(4).tolist()}
    chain = {f"cam{i}": {**camera, **(change if i == 0 else {})} for i in range(3)}
    path = tmp_path / "camchain.yaml"
    path.write_text(yaml.safe_dump({key: one for key, one in chain.items() if key not in change}))
    with pytest.raises(RigError, match=told):
        IMPORTERS["kalibr"](path)


def test_cameras_at_one_place_are_read_without_a_warning() -> None:
    """As of tools that tell turns alone: the way to the point nearest to their axes has no length."""
    poses = np.stack([np.eye(4), np.eye(4)])
    poses[1, :3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    with np.errstate(all="raise"):
        assert aims_off(poses) == pytest.approx(np.pi / 2)
