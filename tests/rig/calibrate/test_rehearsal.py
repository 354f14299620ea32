"""What a new user follows, on made-up videos: from a folder of a board to a rig that is right to millimetres."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from twin_node.cli import main
from twin_node.rig import RigError, load_rig
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
