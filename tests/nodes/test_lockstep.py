"""A launch in lockstep: what it takes of a launch file's player and recorder."""

from __future__ import annotations

import re
import shutil
import threading
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from twin_node.bag import open_log
from twin_node.errors import TwinError
from twin_node.nodes.launch.lockstep import run_in_lockstep
from twin_node.nodes.topics import JOINT_STATES, SEPARATION, GraphError
from twin_node.rig import RigFile, save_rig
from twin_node.scene import Rig, RigCamera

SMALL = {"synchronizer": {"width": 64}, "arm": {"model": "ur5e"}}


def test_the_log_is_never_its_own_output(cell_log: Callable[..., Path], tmp_path: Path) -> None:
    log = tmp_path / "log.mcap"
    shutil.copy(cell_log(0.4), log)
    before = log.read_bytes()
    sections = {**SMALL, "player": {"log": str(log)}, "recorder": {"output": str(log)}}
    with pytest.raises(GraphError, match="expected another file than the log that is played"):
        run_in_lockstep(sections, "test", threading.Event(), print)
    assert log.read_bytes() == before


def test_a_rig_that_is_not_tied_to_the_robot_is_refused(tmp_path: Path) -> None:
    K = np.array([[50.0, 0, 31.5], [0, 50, 23.5], [0, 0, 1]])
    camera = RigCamera("left", 64, 48, K, np.eye(4))
    save_rig(RigFile(Rig((camera,)), frame="left_optical_frame"), tmp_path / "rig.yaml")
    sections = {"/**": {"rig": {"file": str(tmp_path / "rig.yaml")}}, "player": {"log": str(tmp_path / "run.mcap")}}
    with pytest.raises(GraphError, match="found them in 'left_optical_frame'"):
        run_in_lockstep({**SMALL, **sections}, "test", threading.Event(), print)


def test_topics_of_a_foreign_log_are_renamed(cell_log: Callable[..., Path]) -> None:
    """As the error of `--remap` in lockstep says; a topic that is not there tells that the pairs are heeded."""
    player = {"log": str(cell_log(0.4)), "remap": ["/robot/joints:=/joint_states"]}
    with pytest.raises(GraphError, match="has no topic /robot/joints"):
        run_in_lockstep({**SMALL, "player": player}, "test", threading.Event(), print)


def test_the_recorders_topics_are_heeded(cell_log: Callable[..., Path], tmp_path: Path) -> None:
    output = tmp_path / "out.mcap"
    recorder = {"output": str(output), "topics": [SEPARATION, JOINT_STATES, SEPARATION]}
    sections = {**SMALL, "player": {"log": str(cell_log(0.4)), "playback_duration": 0.15}, "recorder": recorder}
    run_in_lockstep(sections, "test", threading.Event(), print)
    with open_log(output) as log:
        assert {topic.name for topic in log.topics} == {SEPARATION, JOINT_STATES}
        told = [bytes(message.data) for message in log.messages(SEPARATION)]
    assert len(told) == len(set(told)), "what is named twice is written once"


def test_what_is_said_of_every_node_is_said_of_player_and_recorder(
    cell_log: Callable[..., Path], tmp_path: Path
) -> None:
    """A launch of processes heeded it; in lockstep the whole log was played, and nothing recorded, without a word."""
    output, log = tmp_path / "out.mcap", str(cell_log(0.4))
    every = {"playback_duration": 0.15, "output": str(output), "topics": [SEPARATION]}
    sections = {**SMALL, "/**": every, "player": {"log": log, "topics": []}}
    run_in_lockstep(sections, "test", threading.Event(), print)
    with open_log(log) as played, open_log(output) as written:
        assert written.end_ns < played.start_ns + 0.25e9
        assert {topic.name for topic in written.topics} == {SEPARATION}


@pytest.mark.parametrize(
    ("node", "values", "words"),
    [
        ("recorder", {"outptu": "a.mcap"}, "test: recorder: unknown parameter 'outptu'; did you mean 'output'?"),
        ("recorder", {"all": True}, "test: recorder: all: expected none in lockstep"),
        ("recorder", {"split": {"max_size_mb": 5.0}}, "test: recorder: split: expected none in lockstep"),
        ("recorder", {"topics": ["/tf"]}, "test: recorder: topics: expected some of /arm/trajectory, "),
        ("player", {"rate": 0.5}, "test: player: rate: expected none in lockstep, where all is dealt with in turn"),
        ("player", {"loop": True}, "test: player: loop: expected none in lockstep"),
        ("player", {"start_paused": True}, "test: player: start_paused: expected none in lockstep"),
        ("player", {"topics": ["/joint_states"]}, "test: player: topics: expected none in lockstep"),
        ("player", {"log": ""}, "test: player: expected 'log', the file or folder to play; give log:=LOG"),
        ("/**", {"rig": {"scenario": "demo"}}, "test: /**: rig: expected a rig file, or the log that is played"),
        ("/**", {"rig": {"log": "other.mcap"}}, "whose images these are, found other.mcap; leave it out"),
    ],
)
def test_what_cannot_be_heeded_is_refused(
    cell_log: Callable[..., Path], tmp_path: Path, node: str, values: dict[str, object], words: str
) -> None:
    sections: dict[str, dict[str, object]] = {"player": {"log": str(cell_log(0.4))}, "recorder": {}, "/**": {}}
    sections[node] |= values
    with pytest.raises(TwinError, match=re.escape(words)):
        run_in_lockstep({**SMALL, **sections}, "test", threading.Event(), print)
