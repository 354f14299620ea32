"""Lenses, sizes and units of other tools' calibrations, number by number."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
import pytest

from twin_node.rig.calibrate.importers import IMPORTERS
from twin_node.rig.calibrate.importers.colmap_files import MODEL_NAMES, MODEL_PARAMETERS
from twin_node.rig.errors import RigError
from twin_node.scene import RigCamera

QUALISYS = """<calibration><cameras>
<camera active="1" serial="71"><fov_video left="8" top="4" right="1287" bottom="723"/>
<transform x="1000" y="2000" z="1500" r11="1" r12="0" r13="0" r21="0" r22="0" r23="1" r31="0" r32="-1" r33="0"/>
<intrinsic focalLengthU="64000" focalLengthV="64640" centerPointU="41472" centerPointV="23552"
radialDistortion1="-6.4" radialDistortion2="3.2" tangentalDistortion1="0.064" tangentalDistortion2="-0.128"/></camera>
<camera active="0" serial="72"/></cameras></calibration>"""


def test_a_lens_of_qualisys_is_in_64ths_of_a_pixel_and_counts_from_its_window(tmp_path: Path) -> None:
    path = tmp_path / "rig.qca.txt"
    path.write_text(QUALISYS)
    (camera,) = IMPORTERS["qualisys"](path).rig.cameras
    assert (camera.width, camera.height) == (1280, 720)
    np.testing.assert_allclose(camera.K, [[1000, 0, 648 - 8], [0, 1010, 368 - 4], [0, 0, 1]])
    np.testing.assert_allclose(camera.D, [-0.1, 0.05, 0.001, -0.002])
    np.testing.assert_allclose(camera.T_base_cam[:3, 3], [1, 2, 1.5])
    # Its rows are the axes of a camera that looks along -z with y up: x stays, y is down and z forward here.
    np.testing.assert_allclose(camera.T_base_cam[:3, :3].T, [[1, 0, 0], [0, 0, -1], [0, 1, 0]])


def colmap(tmp_path: Path, camera: str, unit: float | None = None) -> RigCamera:
    (tmp_path / "cameras.txt").write_text(f"1 {camera}\n")
    (tmp_path / "images.txt").write_text("1 1 0 0 0 0.5 -0.25 2 1 left.png\n\n")
    importer = IMPORTERS["colmap"]
    return (importer(tmp_path) if unit is None else importer(tmp_path, unit)).rig.cameras[0]


@pytest.mark.parametrize(
    ("camera", "K", "D", "model"),
    [
        ("SIMPLE_RADIAL 640 480 500 320.5 240.5 0.1", (500, 500, 320, 240), [0.1, 0, 0, 0, 0], "plumb_bob"),
        ("PINHOLE 640 480 500 510 320.5 240.5", (500, 510, 320, 240), [0, 0, 0, 0, 0], "plumb_bob"),
        (
            "OPENCV 640 480 500 510 320.5 241.5 0.1 -0.2 0.003 0.004",
            (500, 510, 320, 241),
            [0.1, -0.2, 0.003, 0.004, 0],
            "plumb_bob",
        ),
        (
            "FULL_OPENCV 640 480 500 510 320.5 241.5 0.1 -0.02 0.003 0.004 0.05 0.06 -0.007 0.008",
            (500, 510, 320, 241),
            [0.1, -0.02, 0.003, 0.004, 0.05, 0.06, -0.007, 0.008],
            "rational_polynomial",
        ),
        ("SIMPLE_FISHEYE 640 480 500 320.5 240.5", (500, 500, 320, 240), [0, 0, 0, 0], "equidistant"),
        ("FISHEYE 640 480 500 510 320.5 240.5", (500, 510, 320, 240), [0, 0, 0, 0], "equidistant"),
        ("RADIAL_FISHEYE 640 480 500 320.5 240.5 0.1 -0.02", (500, 500, 320, 240), [0.1, -0.02, 0, 0], "equidistant"),
    ],
    ids=lambda value: value.split()[0] if isinstance(value, str) else None,
)
def test_lenses_of_colmap_are_read_parameter_by_parameter(
    tmp_path: Path, camera: str, K: tuple[float, ...], D: list[float], model: str
) -> None:
    found = colmap(tmp_path, camera)
    np.testing.assert_allclose(found.K[[0, 1, 0, 1], [0, 1, 2, 2]], K)
    np.testing.assert_allclose(found.D, D)
    assert found.distortion_model == model


def test_camera_models_have_the_names_and_numbers_of_colmap_itself() -> None:
    pycolmap = pytest.importorskip("pycolmap")
    for kind, (name, parameters) in enumerate(zip(MODEL_NAMES, MODEL_PARAMETERS, strict=True)):
        if not hasattr(pycolmap.CameraModelId, name):
            continue  # an older COLMAP
        camera = pycolmap.Camera(model=pycolmap.CameraModelId(kind))
        assert (camera.model_name, len(camera.params_info.split(","))) == (name, parameters)


def test_a_binary_model_of_a_newer_colmap_is_told_from_one_that_is_cut_short(tmp_path: Path) -> None:
    (tmp_path / "cameras.bin").write_bytes(struct.pack("<QiiQQ2d", 1, 7, len(MODEL_NAMES), 640, 480, 500, 500))
    with pytest.raises(
        RigError, match=r"camera 7: expected a model from 0 to 17 \(EQUIRECTANGULAR\), found 18.*as text"
    ):
        IMPORTERS["colmap"](tmp_path)


def test_a_unit_of_colmap_is_a_metre_unless_told(tmp_path: Path) -> None:
    lens = "PINHOLE 640 480 500 510 320.5 240.5"
    np.testing.assert_allclose(colmap(tmp_path, lens).T_base_cam[:3, 3], [-0.5, 0.25, -2])
    np.testing.assert_allclose(colmap(tmp_path, lens, 0.1).T_base_cam[:3, 3], [-0.05, 0.025, -0.2])


TOML = """[cam_0]
name = "left"
size = [640, 480]
matrix = [[500, 0, 320], [0, 500, 240], [0, 0, 1]]
distortions = {D}
rotation = [0, 0, 0]
translation = [1, 0, 0]
"""


@pytest.mark.parametrize(
    ("D", "model", "read"),
    [
        ([0.1, 0.01, 0, 0, 0.02], "plumb_bob", [0.1, 0.01, 0, 0, 0.02]),
        ([0.1, 0.01, 0, 0, 0.02, 0.0, 0.0, 0.0], "plumb_bob", [0.1, 0.01, 0, 0, 0.02]),
        ([0.1, 0.01, 0, 0, 0.02, 0.03], "rational_polynomial", [0.1, 0.01, 0, 0, 0.02, 0.03, 0, 0]),
    ],
)
def test_a_sixth_coefficient_makes_a_rational_lens(
    tmp_path: Path, D: list[float], model: str, read: list[float]
) -> None:
    path = tmp_path / "rig.toml"
    path.write_text(TOML.replace("{D}", str(D)))
    (camera,) = IMPORTERS["toml"](path).rig.cameras
    assert camera.distortion_model == model
    np.testing.assert_allclose(camera.D, read)
    np.testing.assert_allclose(camera.T_base_cam[:3, 3], [-1, 0, 0])


def test_a_chain_of_kalibr_is_in_metres_and_its_clock_is_the_rig_s_unless_told(tmp_path: Path) -> None:
    lens = (
        "  camera_model: pinhole\n  distortion_model: radtan\n  intrinsics: [500, 501, 320, 240]\n"
        "  distortion_coeffs: [0.1, 0.01, 0.001, 0.002]\n  resolution: [640, 480]\n"
    )
    chain = "[[1, 0, 0, 0.2], [0, 1, 0, -0.1], [0, 0, 1, 0.05], [0, 0, 0, 1]]"
    path = tmp_path / "camchain.yaml"
    path.write_text(f"cam0:\n{lens}cam1:\n{lens}  T_cn_cnm1: {chain}\n")
    first, second = IMPORTERS["kalibr"](path).rig.cameras
    np.testing.assert_allclose(second.T_base_cam[:3, 3], [-0.2, 0.1, -0.05])
    np.testing.assert_allclose(IMPORTERS["kalibr"](path, 0.1).rig.cameras[1].T_base_cam[:3, 3], [-0.02, 0.01, -0.005])
    assert (first.time_offset_ns, second.time_offset_ns) == (0, 0)
    np.testing.assert_allclose(first.D, [0.1, 0.01, 0.001, 0.002])
