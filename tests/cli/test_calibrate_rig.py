"""What `calibrate rig` says of a rig file that it replaces."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twin_node.cli.calibrate import _written_by_hand
from twin_node.rig import RigFile, save_rig
from twin_node.scene import Rig, RigCamera


def test_what_a_replaced_file_held_by_hand_is_told(tmp_path: Path) -> None:
    K = np.array([[500.0, 0, 319.5], [0, 500.0, 239.5], [0, 0, 1]])
    camera = RigCamera("left", 640, 480, K, np.eye(4), "plumb_bob", np.zeros(5))
    path = tmp_path / "rig.yaml"
    assert _written_by_hand(path) == []
    save_rig(RigFile(Rig((camera,), np.array([[0.0, 0, 0], [1, 1, 1]])), notes="Mind the lamp."), path)
    assert _written_by_hand(path) == ["workspace", "notes"]
    save_rig(RigFile(Rig((camera,))), path)
    assert _written_by_hand(path) == []
    path.write_text("no rig", encoding="utf-8")
    assert _written_by_hand(path) == []
