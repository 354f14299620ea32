"""The page of a calibration: whole, on its own, and honest about what it was given."""

from __future__ import annotations

import base64
import re
from dataclasses import replace
from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import pytest
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.transforms import Bbox
from mpl_toolkits.mplot3d import Axes3D
from simulated_boards import a_lens, around

from twin_node.geometry import inverse_pose, looking_at, transform
from twin_node.rig import CameraEvidence, RigError, RigFile
from twin_node.rig.calibrate import report_pictures
from twin_node.rig.calibrate.boards import Chessboard, Corners
from twin_node.rig.calibrate.bundle import Sighting
from twin_node.rig.calibrate.lenses import lens_of, raw_pixels
from twin_node.rig.calibrate.pose_graph import board_pose
from twin_node.rig.calibrate.report import Calibration, write_report
from twin_node.rig.calibrate.report_pictures import _outline
from twin_node.rig.calibrate.rig_fit import BoardViews, _Eyes, _motion, fit, settled
from twin_node.scene import Rig, RigCamera

BOARD = Chessboard(6, 5, 0.05)


@pytest.fixture
def rig_file() -> RigFile:
    lens = a_lens()
    cameras = tuple(
        RigCamera(f"cam{i}", 640, 480, lens.K, T, lens.distortion_model, lens.D) for i, T in enumerate(around(3))
    )
    covariance = np.diag([4e-6, 1e-6, 9e-6, 1e-6, 1e-6, 1e-6])
    evidence = tuple(CameraEvidence(0.2, 0.1, 8, 240, covariance) for _ in cameras)
    return RigFile(Rig(cameras), date="2026-03-02", board=str(BOARD), evidence=evidence)


def sightings_of(rig: Rig, noise_px: float) -> tuple[Sighting, ...]:
    """Eight boards before all cameras, the corners with noise."""
    rng = np.random.default_rng(2)
    seen = []
    for number in range(8):
        T_base_board = inverse_pose(looking_at(rng.uniform(-0.2, 0.2, 3), rng.uniform(-1, 1, 3) + np.array([0, 0, 3])))
        T_base_board[:3, 3] = rng.uniform(-0.2, 0.2, 3)
        for i, camera in enumerate(rig.cameras):
            points = transform(inverse_pose(camera.T_base_cam) @ T_base_board, BOARD.points)
            pixels = raw_pixels(camera, points) + rng.normal(0, noise_px, (len(points), 2))
            seen.append(Sighting(i, number, Corners(np.arange(len(points)), pixels)))
    return tuple(seen)


def pictures_in(page: Path) -> list[np.ndarray]:
    encoded = re.findall(r'base64,([^"]+)"', page.read_text())
    return [cv2.imdecode(np.frombuffer(base64.b64decode(one), np.uint8), cv2.IMREAD_COLOR) for one in encoded]


def test_a_page_with_a_rig_before_and_residuals(rig_file: RigFile, tmp_path: Path) -> None:
    shifted = tuple(replace(c, K=c.K + np.diag([4, 4, 0])) for c in rig_file.rig.cameras)
    before = replace(rig_file, rig=replace(rig_file.rig, cameras=shifted))
    seen = sightings_of(rig_file.rig, 0.2)
    now, then = (Calibration(one, settled(BOARD, one.rig, fit(BOARD, one.rig, seen))) for one in (rig_file, before))
    write_report(now, "rig", tmp_path / "page.html", then)
    page = (tmp_path / "page.html").read_text()
    assert all(title in page for title in ("The rig", "Links", "Residuals", "Coverage", "before: median"))
    assert "<script" not in page
    drawn = pictures_in(tmp_path / "page.html")
    assert len(drawn) == 4
    assert all(picture.std() > 5 for picture in drawn)


@pytest.mark.parametrize("height", [0.3, 1.4])
def test_the_drawings_of_a_rig_do_not_lie_upon_each_other(
    rig_file: RigFile, height: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Names and numbers of the oblique one stood upon those of what is beside it."""
    looked_at = np.array([0.1, 0.1, 1.0])
    poses = (looking_at(np.array(place), looked_at) for place in ((0, 0, 0), (1.0, -0.5, 0.3), (1.3, -0.6, height)))
    cameras = (replace(camera, T_base_cam=pose) for camera, pose in zip(rig_file.rig.cameras, poses, strict=True))
    rig_file = replace(rig_file, rig=Rig(tuple(cameras)))
    drawn: list[Figure] = []
    monkeypatch.setattr(report_pictures, "_picture", lambda *given: drawn.append(given[-1]))
    report_pictures.draw_rig(rig_file, None)
    drawn[0].draw_without_rendering()
    boxes = [_box_of(axes) for axes in drawn[0].axes]
    assert not any(one.overlaps(other) for one, other in combinations(boxes, 2))


def _box_of(axes: Axes) -> Bbox:
    """All that can be seen of a drawing: its lines, numbers and names."""
    axis = (axes.xaxis, axes.yaxis, *([axes.zaxis] if isinstance(axes, Axes3D) else []))
    seen = [part.get_tightbbox() for part in (*axes.lines, *axes.texts, axes.title, *axis)]
    return Bbox.union([box for box in seen if box is not None])


def test_without_recordings_the_rig_alone_is_drawn(rig_file: RigFile, tmp_path: Path) -> None:
    write_report(Calibration(rig_file), "rig", tmp_path / "page.html")
    assert len(pictures_in(tmp_path / "page.html")) == 1
    assert "99 % probability" in (tmp_path / "page.html").read_text()
    assert "<td>0.100</td><td>0.200</td>" in (tmp_path / "page.html").read_text()


def test_a_rig_that_saw_no_board_has_no_count_of_views(rig_file: RigFile, tmp_path: Path) -> None:
    timed = tuple(CameraEvidence(time_offset_sigma=1e-4) for _ in rig_file.rig.cameras)
    write_report(Calibration(replace(rig_file, evidence=timed)), "rig", tmp_path / "page.html")
    assert "<td>-</td><td>-</td><td>-</td>" in (tmp_path / "page.html").read_text()


def test_settled_boards_leave_no_more_than_the_noise(rig_file: RigFile) -> None:
    seen = sightings_of(rig_file.rig, 0.3)
    rough = fit(BOARD, rig_file.rig, seen)
    rms = [
        float(np.sqrt((np.concatenate(one.residuals) ** 2).mean()))
        for one in (rough, settled(BOARD, rig_file.rig, rough))
    ]
    assert rms[1] < rms[0]
    assert rms[1] == pytest.approx(0.3, rel=0.1)


def test_each_board_lies_where_the_camera_that_explains_all_best_sees_it(rig_file: RigFile) -> None:
    """Some corners are hidden, and one camera's are wrong: what it says of the board explains the others worst."""
    rng = np.random.default_rng(5)
    seen = []
    for sighting in sightings_of(rig_file.rig, 0.2):
        ids = np.sort(rng.choice(len(BOARD.points), rng.integers(8, len(BOARD.points)), replace=False))
        wrong = 20 * rng.normal(size=(len(ids), 2)) * (sighting.camera == sighting.board % 3)
        seen.append(replace(sighting, corners=Corners(ids, sighting.corners.pixels[ids] + wrong)))
    found = fit(BOARD, rig_file.rig, seen)
    assert len(found.residuals) == len(seen)
    for number in range(8):
        rows = [row for row, sighting in enumerate(found.sightings) if sighting.board == number]
        group = [found.sightings[row] for row in rows]
        candidates = []
        for told in group:
            camera = rig_file.rig.cameras[told.camera]
            T_cam_board = board_pose(lens_of(camera), BOARD.points[told.corners.ids], told.corners.pixels)
            assert T_cam_board is not None
            candidates.append([residual_of(rig_file.rig, one, camera.T_base_cam @ T_cam_board) for one in group])
        best = min(candidates, key=lambda residuals: np.linalg.norm(np.concatenate(residuals), axis=1).mean())
        for row, expected in zip(rows, best, strict=True):
            np.testing.assert_allclose(found.residuals[row], expected, atol=1e-9)


def residual_of(rig: Rig, sighting: Sighting, T_base_board: np.ndarray) -> np.ndarray:
    camera = rig.cameras[sighting.camera]
    points = transform(inverse_pose(camera.T_base_cam) @ T_base_board, BOARD.points[sighting.corners.ids])
    return np.asarray(sighting.corners.pixels - raw_pixels(camera, points))


def test_slopes_of_residuals_are_those_of_differences(rig_file: RigFile) -> None:
    eyes, group = _Eyes.of(BOARD, rig_file.rig), sightings_of(rig_file.rig, 0.2)[:3]
    start, step = (
        inverse_pose(looking_at(np.zeros(3), np.array([0.3, 0.2, 3.0]))),
        np.array([0.2, -0.1, 0.3, 0.02, 0, 0.01]),
    )

    def off(step: np.ndarray) -> np.ndarray:
        return np.concatenate(eyes.residuals(group, [start @ _motion(step)] * len(group)))

    differences = [(off(step + 1e-6 * axis) - off(step - 1e-6 * axis)) / 2e-6 for axis in np.eye(6)]
    np.testing.assert_allclose(eyes.slopes(group, start, step), np.stack(differences, -1), rtol=1e-6, atol=1e-3)


def test_a_view_is_worked_out_once_per_lens(rig_file: RigFile, monkeypatch: pytest.MonkeyPatch) -> None:
    looks = []
    monkeypatch.setattr("twin_node.rig.calibrate.rig_fit.board_pose", lambda *a: looks.append(a) or board_pose(*a))
    seen, views = sightings_of(rig_file.rig, 0.2), BoardViews(BOARD)
    first = fit(BOARD, rig_file.rig, seen, views)
    assert len(looks) == len(seen)
    moved = tuple(
        replace(c, T_base_cam=c.T_base_cam @ looking_at(np.zeros(3), np.ones(3))) for c in rig_file.rig.cameras
    )
    fit(BOARD, Rig(moved), seen, views)
    assert len(looks) == len(seen)
    other = tuple(replace(c, K=c.K * np.array([[1.1], [1.1], [1]])) for c in rig_file.rig.cameras)
    np.testing.assert_array_equal(
        np.concatenate(fit(BOARD, Rig(other), seen, views).residuals),
        np.concatenate(fit(BOARD, Rig(other), seen).residuals),
    )
    assert len(looks) == 3 * len(seen)
    np.testing.assert_array_equal(first.residuals[0], fit(BOARD, rig_file.rig, seen, views).residuals[0])


def test_a_rig_of_other_cameras_and_a_place_that_is_none_are_refused(rig_file: RigFile, tmp_path: Path) -> None:
    other = replace(rig_file, rig=Rig(rig_file.rig.cameras[:2]), evidence=rig_file.evidence[:2])
    with pytest.raises(RigError, match="earlier file of the same rig"):
        write_report(Calibration(rig_file), "rig", tmp_path / "page.html", Calibration(other))
    with pytest.raises(RigError, match="cannot be written"):
        write_report(Calibration(rig_file), "rig", tmp_path / "nowhere" / "page.html")


def test_a_fisheye_is_drawn_no_larger_than_other_cameras() -> None:
    """The corners of its image are seen at right angles to its axis: the rig was a dot between pyramids of 20 m."""
    K = np.array([[320.0, 0, 639.5], [0, 320.0, 479.5], [0, 0, 1]])
    wide = RigCamera("cam0", 1280, 960, K, around(3)[0], "equidistant", np.array([0.02, -0.01, 0.002, 0.0]))
    outline = transform(inverse_pose(wide.T_base_cam), _outline(wide, 0.3))
    assert np.linalg.norm(outline, axis=1).max() < 0.7
    K = np.array([[1280.0, 0, 639.5], [0, 1280.0, 479.5], [0, 0, 1]])
    outline = transform(inverse_pose(wide.T_base_cam), _outline(replace(wide, K=K, D=np.zeros(4)), 0.3))
    np.testing.assert_allclose(outline[outline[:, 2] > 1e-9, 2], 0.3)
