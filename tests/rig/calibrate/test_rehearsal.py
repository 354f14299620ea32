"""What a new user follows, on made-up videos: from a folder of a board to a rig that is right to millimetres."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twin_node.cli import main
from twin_node.geometry import inverse_pose, pose
from twin_node.rig import RigError, load_rig
from twin_node.rig.calibrate import rehearsal
from twin_node.rig.calibrate.board_prints import draw_board
from twin_node.rig.calibrate.rehearsal import rehearse


def test_the_way_of_the_how_to_ends_at_the_truth(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    session, rig, page = tmp_path / "session", tmp_path / "rig.yaml", tmp_path / "page.html"
    assert main(["calibrate", "rehearse", str(session)]) == 0
    assert "--board-is-base-at 19" in capsys.readouterr().out
    assert main(["calibrate", "rig", str(session), "--board-is-base-at", "19", "-o", str(rig)]) == 0
    assert main(["calibrate", "check", str(rig), str(session)]) == 0
    before = ["--before", str(session / "truth.yaml"), "--pictures", str(tmp_path / "pictures")]
    assert main(["calibrate", "report", str(rig), str(session), *before, "-o", str(page)]) == 0
    assert {path.name for path in (tmp_path / "pictures").iterdir()} >= {"the_rig.png", "links.png", "coverage.png"}
    for found, true in zip(load_rig(rig).rig.cameras, load_rig(session / "truth.yaml").rig.cameras, strict=True):
        assert np.linalg.norm(found.T_base_cam[:3, 3] - true.T_base_cam[:3, 3]) < 0.006
        assert abs(found.time_offset_ns - true.time_offset_ns) < 2_000_000


def test_a_folder_that_exists_is_left_alone(tmp_path: Path) -> None:
    with pytest.raises(RigError, match="does not exist yet"):
        rehearse(tmp_path)
    assert not list(tmp_path.iterdir())


def test_a_folder_of_the_name_that_it_grows_under_is_left_alone(tmp_path: Path) -> None:
    """It is another rehearsal's, or somebody's own."""
    mine = tmp_path / "session.partial" / "mine.txt"
    mine.parent.mkdir()
    mine.write_text("precious")
    with pytest.raises(RigError, match=r"session\.partial: exists already, .*; move it elsewhere"):
        rehearse(tmp_path / "session")
    assert mine.read_text() == "precious"


def test_what_is_interrupted_leaves_nothing(tmp_path: Path) -> None:
    def interrupted(images: object = None) -> None:
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        rehearse(tmp_path / "session", interrupted)
    assert not list(tmp_path.iterdir())


def test_videos_that_the_disk_takes_but_a_part_of_are_refused(tmp_path: Path) -> None:
    """OpenCV says nothing of it: the rehearsal was told to be whole, with videos that nothing opens."""
    session = tmp_path / "session"
    command = [sys.executable, "-m", "twin_node", "calibrate", "rehearse", str(session)]
    limited = ["sh", "-c", 'ulimit -f 1000; exec "$@"', "sh", *command]
    done = subprocess.run(limited, capture_output=True, text=True, check=False)
    assert done.returncode == 2
    told = done.stderr.splitlines()[-1]
    assert told.startswith(f"twin_node: error: {session}: cannot be made (left.mp4 took 0 of 200 images); free space")
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize("tilt", [0.4, 1.45])
def test_a_ray_sees_the_board_where_it_meets_its_plane_and_nothing_behind_the_camera(tilt: float) -> None:
    """Tilted to near the camera's level, half of the image looks over the plane's horizon."""
    sheet = np.add.outer(0.04 * np.arange(1400), 0.03 * np.arange(1400)).astype(np.uint8)  # darker than all behind it
    drawing = draw_board(rehearsal.BOARD)
    T = pose(Rotation.from_euler("x", np.pi - tilt).as_matrix(), np.array([-0.1, 0.21, 0.6]))
    v, u = np.mgrid[: rehearsal.HEIGHT : 40, : rehearsal.WIDTH : 40]
    rays = np.stack([(u - 320) / 560, (v - 240) / 560], axis=-1)
    seen = rehearsal._picture(rays.astype(np.float32), T, sheet, drawing)
    to_board = inverse_pose(T)
    wanted = np.full(seen.shape, float(rehearsal.GREY))
    for place in np.ndindex(seen.shape):
        direction = to_board[:3, :3] @ [*rays[place], 1.0]
        reach = -to_board[2, 3] / direction[2]
        x, y = ((to_board[:2, 3] + reach * direction[:2] + drawing.margin) * rehearsal.PIXELS_PER_M - 0.5).tolist()
        if reach > 0 and 0 <= x < 1399 and 0 <= y < 1399:
            wanted[place] = sheet[round(y), round(x)]
    assert 20 < (wanted != rehearsal.GREY).sum() < wanted.size - 20
    np.testing.assert_allclose(seen, wanted, atol=1)
