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
from twin_node.rig.rig_checks import whole_coefficients

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
    content["distortion_model"], content["distortion_coefficients"] = "", {"rows": 1, "cols": 0, "data": []}
    path.write_text(yaml.safe_dump(content))
    lens = load_camera_info(path).lens
    assert (lens.distortion_model, lens.D.tolist()) == ("plumb_bob", [0.0] * 5)


def test_images_numbered_alike_in_a_folder_per_camera_are_named_after_both(tmp_path: Path) -> None:
    (tmp_path / "cameras.txt").write_text("1 PINHOLE 640 480 500 500 320 240\n")
    poses = [f"{i} 1 0 0 0 {i} 0 0 1 {name}/0001.png\n\n" for i, name in enumerate(("left", "right"))]
    (tmp_path / "images.txt").write_text("".join(poses))
    assert [camera.name for camera in IMPORTERS["colmap"](tmp_path).rig.cameras] == ["left_0001", "right_0001"]
