"""Real recordings of boards: the published results are reached, and customary mistakes are named."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from twin_node.cli import main
from twin_node.geometry import inverse_pose
from twin_node.rig import load_rig
from twin_node.rig.calibrate.board_files import find_board
from twin_node.rig.calibrate.check import check_against_board
from twin_node.rig.calibrate.extrinsics import calibrate_rig
from twin_node.rig.calibrate.importers import IMPORTERS
from twin_node.rig.calibrate.recordings import load_cameras
from twin_node.rig.calibrate.results import residuals_of_all, rig_file_of
from twin_node.rig.calibrate.rig_fit import common_sightings
from twin_node.scene import Float64, Rig


def test_the_stereo_pair_meets_the_published_figures(
    recordings: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = str(recordings / "chessboard_stereo")
    for side, rms in (("left", 0.41), ("right", 0.46)):
        pictures = [str(path) for path in sorted(Path(folder).glob(f"{side}*.jpg"))]
        assert main(["calibrate", "intrinsics", *pictures, "--board", "chessboard:9x6:1.0", "--json"]) == 0
        figures = json.loads(capsys.readouterr().out)
        assert figures["rms_px"] <= rms
        assert figures["views"] == 13
    rig = str(tmp_path / "rig.yaml")
    assert main(["calibrate", "rig", folder, "--board", "chessboard:9x6:1.0", "-o", rig, "--json"]) == 0
    figures = json.loads(capsys.readouterr().out)
    assert figures["rms_px"] <= 0.45
    for camera in figures["cameras"].values():
        assert camera["K"][0][0] == pytest.approx(536, abs=2)
    baseline = np.linalg.norm(load_rig(rig).rig.cameras[1].T_base_cam[:3, 3])
    assert baseline == pytest.approx(3.34, abs=0.02)


def disagreement(found: Float64, reference: Float64) -> Float64:
    """[C] distances between camera positions [C, 3] after alignment (Umeyama 1991), as shares of the rig's size."""
    a, b = found - found.mean(axis=0), reference - reference.mean(axis=0)
    U, S, Vt = np.linalg.svd(b.T @ a)
    sign = np.array([1, 1, np.sign(np.linalg.det(U @ Vt))])
    aligned = (S * sign).sum() / (a**2).sum() * a @ (U * sign @ Vt).T
    size = np.linalg.norm(reference[:, None] - reference[None], axis=2).max()
    return np.asarray(np.linalg.norm(aligned - b, axis=1) / size)


def test_four_free_running_cameras_are_calibrated_from_their_videos_alone(recordings: Path) -> None:
    folder = recordings / "charuco_4cam"
    board = find_board(folder)
    cameras = load_cameras(folder, board)
    solution = calibrate_rig(board, cameras)
    assert residuals_of_all(solution.bundle.residuals).median_px <= 0.2
    rig = rig_file_of(solution).rig
    assert [camera.name for camera in rig.cameras] == ["cam_0", "cam_1", "cam_2", "cam_3"]
    reference = IMPORTERS["toml"](folder / "camera_array.toml", 1.0).rig
    found = np.stack([camera.T_base_cam[:3, 3] for camera in rig.cameras])
    assert disagreement(found, np.stack([c.T_base_cam[:3, 3] for c in reference.cameras])).max() < 0.01

    sightings = common_sightings(board, rig, cameras)
    assert not check_against_board(board, rig, sightings).findings
    for cause, wrong in mistakes(rig).items():
        (finding,) = check_against_board(board, wrong, sightings).findings
        assert cause in str(finding)


def mistakes(rig: Rig) -> dict[str, Rig]:
    """The rig as customary mistakes leave it, by what names them."""
    a, b, c, d = rig.cameras
    half = np.diag([0.5, 0.5, 1.0])

    def posed(change: dict[str, Float64]) -> Rig:
        return Rig(tuple(replace(x, T_base_cam=change[x.name]) for x in rig.cameras))

    millimetres = {x.name: x.T_base_cam * np.array([[1, 1, 1, 1000]] * 3 + [[1, 1, 1, 1]]) for x in rig.cameras}
    transposed = {x.name: x.T_base_cam.copy() for x in rig.cameras}
    for T in transposed.values():
        T[:3, :3] = T[:3, :3].T.copy()
    return {
        "millimetres": posed(millimetres),
        "OpenGL": posed({x.name: x.T_base_cam * np.array([1, -1, -1, 1]) for x in rig.cameras}),
        "transposed": posed(transposed),
        "base-to-camera": posed({x.name: inverse_pose(x.T_base_cam) for x in rig.cameras}),
        "swapped": Rig((a, replace(c, name=b.name), replace(b, name=c.name), d)),
        "resolution": Rig((a, replace(b, K=half @ b.K), c, d)),
    }


def test_qualisys_and_its_conversions_agree(recordings: Path) -> None:
    folder = recordings / "walker_4cam"
    rigs = [
        IMPORTERS["qualisys"](folder / "Calib.qca.txt").rig,
        IMPORTERS["toml"](folder / "Calib_qualisys.toml", 1.0).rig,
        IMPORTERS["opencv"](folder / "calib_opencv.json", 1.0).rig,
    ]
    for cameras in zip(*(rig.cameras for rig in rigs), strict=True):
        for camera in cameras[1:]:
            np.testing.assert_allclose(camera.T_base_cam, cameras[0].T_base_cam, atol=1e-9)
            np.testing.assert_allclose(camera.K, cameras[0].K)
            np.testing.assert_allclose(camera.D[:4], cameras[0].D[:4])


def test_the_report_is_one_page(recordings: Path, tmp_path: Path) -> None:
    folder = recordings / "chessboard_stereo"
    for side in ("left", "right"):
        for number in (1, 2, 3, 4, 5):
            image = cv2.imread(str(folder / f"{side}0{number}.jpg"))
            assert cv2.imwrite(str(tmp_path / f"{side}0{number}.png"), image)
    board, rig, page = "chessboard:9x6:0.025", tmp_path / "rig.yaml", tmp_path / "page.html"
    assert main(["calibrate", "rig", str(tmp_path), "--board", board, "-o", str(rig)]) == 0
    assert main(["calibrate", "report", str(rig), str(tmp_path), "--board", board, "-o", str(page)]) == 0
    text = page.read_text()
    assert text.count("data:image/png;base64,") == 4  # the rig, its links, residuals, coverage
    assert "http" not in text
    assert "left" in text and "right" in text
