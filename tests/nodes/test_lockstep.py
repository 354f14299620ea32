"""A launch in lockstep: what it takes of a launch file's player and recorder."""

from __future__ import annotations

import shutil
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from twin_node.nodes.launch.lockstep import run_in_lockstep
from twin_node.nodes.topics import GraphError
from twin_node.rig import RigFile, save_rig
from twin_node.scene import Rig, RigCamera

SMALL = {"synchronizer": {"width": 64}, "arm": {"model": "ur5e"}}


def test_the_log_is_never_its_own_output(cell_log: Callable[..., Path], tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    shutil.copy(cell_log(0.4), log)
    before = log.read_bytes()
    sections = {**SMALL, "player": {"log": str(log)}, "recorder": {"output": str(log)}}
    with pytest.raises(GraphError, match="expected another file than the log that is played"):
        run_in_lockstep(sections, "test", threading.Event())
    assert log.read_bytes() == before


def test_a_rig_that_is_not_tied_to_the_robot_is_refused(tmp_path: Path) -> None:
    K = np.array([[50.0, 0, 31.5], [0, 50, 23.5], [0, 0, 1]])
    camera = RigCamera("left", 64, 48, K, np.eye(4))
    save_rig(RigFile(Rig((camera,)), frame="left_optical_frame"), tmp_path / "rig.yaml")
    sections = {"/**": {"rig": {"file": str(tmp_path / "rig.yaml")}}, "player": {"log": str(tmp_path / "run.mcap")}}
    with pytest.raises(GraphError, match="found them in 'left_optical_frame'"):
        run_in_lockstep({**SMALL, **sections}, "test", threading.Event())


def test_topics_of_a_foreign_log_are_renamed(cell_log: Callable[..., Path]) -> None:
    """As the error of `--remap` in lockstep says; a topic that is not there tells that the pairs are heeded."""
    player = {"log": str(cell_log(0.4)), "remap": ["/robot/joints:=/joint_states"]}
    with pytest.raises(GraphError, match="has no topic /robot/joints"):
        run_in_lockstep({**SMALL, "player": player}, "test", threading.Event())
