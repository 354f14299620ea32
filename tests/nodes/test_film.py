"""Films and pictures of a log, read back."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import cv2
import numpy as np
import pytest
from twin_logs import START, cloud_at, obstacles_at

from twin_node.cli import main
from twin_node.nodes.film.orbit import draw_boxes, orbit_camera
from twin_node.nodes.playback import Playback
from twin_node.nodes.report.quality import render_cloud

pytest.importorskip("av")


def render(*arguments: object) -> int:
    return main(["render", *map(str, arguments)])


def test_a_film_has_every_picture_of_its_span(twin_log: Path, tmp_path: Path) -> None:
    out = tmp_path / "a.mp4"
    assert render(twin_log, "--view", "orbit", "--width", 64, "--rate", 10, "--stop", 1.0, "-o", out) == 0
    film = cv2.VideoCapture(str(out))
    pictures = []
    while (read := film.read())[0]:
        pictures.append(read[1])
    assert len(pictures) == 11 and film.get(cv2.CAP_PROP_FPS) == pytest.approx(10)
    assert pictures[0].shape == (22 + 36, 64, 3)
    assert not np.array_equal(pictures[0], pictures[10])


def test_a_picture_shows_images_beside_the_twin(twin_log: Path, cell_log: Callable[..., Path], tmp_path: Path) -> None:
    """One row per camera; the first column is what the camera saw, the second what the cloud looks like from there."""
    seen, out = cell_log(0.5), tmp_path / "a.png"
    assert render(twin_log, seen, "--width", 80, "--at", 0.3, "-o", out) == 0
    picture = cv2.cvtColor(cv2.imread(str(out)), cv2.COLOR_BGR2RGB)
    with Playback([twin_log, seen], 80) as playback:
        frames = playback.at(START + 300_000_000).frames
    assert frames is not None
    view = frames.views[1]
    height = view.camera.height
    row = picture[22 + height : 22 + 2 * height]
    assert row.shape[1] == 4 * 80 and picture.shape[0] == 22 + 3 * height
    assert np.array_equal(row[:, :80], view.rgb)
    expected = (np.clip(render_cloud(cloud_at(3, True), view.camera), 0, 1) * 255).astype(np.uint8)
    assert np.abs(row[:, 80:160].astype(int) - expected).max() <= 1


def test_the_orbit_looks_at_the_cell_and_boxes_fall_on_what_they_hold(twin_log: Path) -> None:
    with Playback([twin_log]) as playback:
        snapshot = playback.at(START)
    obstacles = obstacles_at(0, START)
    for seconds in (0.0, 3.0, 7.0):
        camera = orbit_camera(snapshot, 160, 90, seconds)
        assert np.allclose(camera.T_base_cam[:3, :3] @ camera.T_base_cam[:3, :3].T, np.eye(3))
        assert camera.T_base_cam[2, 1] < 0  # the image's down is down
        drawn = draw_boxes(np.zeros((90, 160, 3), np.uint8), camera, obstacles, obstacles.ids == 7, (255, 0, 0))
        rows, columns = np.nonzero(drawn[..., 0])
        middle = np.append(obstacles.positions[0], 1) @ camera.viewmat.T
        pixel = (camera.K @ middle[:3])[:2] / middle[2]
        assert columns.min() < pixel[0] < columns.max() and rows.min() < pixel[1] < rows.max()


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["-o", "a.avi"], "ends in .mp4, .png, .jpg"),
        (["-o", "a.png", "--view", "beside"], "expected images, found none"),
        (["-o", "a.png", "--view", "above"], "expected one of beside, cameras, forecast, orbit"),
        (["-o", "a.png", "--camera", "left"], "--camera left: expected one of none"),
        (["-o", "missing/a.mp4"], "cannot be written"),
        (["-o", "a.png", "--at", "7"], "expected a span inside the log's"),
    ],
)
def test_wrong_wishes_are_one_line(
    twin_log: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    arguments: list[str],
    message: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert render(twin_log, *arguments) == 2
    assert message in capsys.readouterr().err
    assert not list(tmp_path.iterdir())
