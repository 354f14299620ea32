"""Which rigs a live graph takes."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from twin_node.bag import LogWriter
from twin_node.messages import convert
from twin_node.nodes.live.rig_source import RigParameters, read_rig, topics_of
from twin_node.nodes.live.setup import Setup
from twin_node.nodes.topics import GraphError
from twin_node.rig import RigFile, save_rig
from twin_node.runtime.parameters import EVERY_NODE, ParameterError
from twin_node.scene import Rig, RigCamera

CAMERA = RigCamera("left", 64, 48, np.array([[50.0, 0, 31.5], [0, 50, 23.5], [0, 0, 1]]), np.eye(4))


@pytest.mark.parametrize("frame", ["left_optical_frame", "tool0"])
def test_a_rig_that_is_not_tied_to_the_robot_drives_no_arm(tmp_path: Path, frame: str) -> None:
    """The twin takes the file's frame for the base: the arm would be judged as if it stood in the camera."""
    save_rig(RigFile(Rig((CAMERA,)), frame=frame), tmp_path / "rig.yaml")
    with pytest.raises(GraphError, match=f"found them in '{frame}'"):
        read_rig(RigParameters(file=str(tmp_path / "rig.yaml")))
    with pytest.raises(GraphError, match=f"found them in '{frame}'"):  # and in place of a log's own calibration
        read_rig(RigParameters(log=str(tmp_path / "run.mcap"), file=str(tmp_path / "rig.yaml")))


@pytest.mark.parametrize("frame", ["base_link", "world"])
def test_a_rig_in_the_base_is_taken(tmp_path: Path, frame: str) -> None:
    save_rig(RigFile(Rig((CAMERA,)), frame=frame), tmp_path / "rig.yaml")
    assert read_rig(RigParameters(file=str(tmp_path / "rig.yaml"))).cameras[0].name == "left"


@pytest.mark.parametrize(
    "given", [{}, {"file": "rig.yaml", "scenario": "demo"}, {"log": "run.mcap", "scenario": "demo"}]
)
def test_a_rig_that_is_told_nowhere_or_twice_is_refused(given: dict[str, str]) -> None:
    """Beside a log the scenario was passed over: a twin looked through cameras that nobody simulated."""
    with pytest.raises(GraphError, match="expected one of file, log and scenario"):
        read_rig(RigParameters(**given))


def test_topics_of_a_driver_in_a_namespace_are_named_from_the_root() -> None:
    """realsense2_camera has its node's name and its camera's before its topics."""
    parameters = RigParameters("rig.yaml", image="/{camera}/{camera}/color/image_raw", depth="depth/image_rect")
    found = topics_of("left", parameters)
    assert (found.image, found.depth) == ("/left/left/color/image_raw", "/left/depth/image_rect")
    with pytest.raises(GraphError, match=r"depth: expected \{camera\} in a topic from the root, found /d/image"):
        RigParameters("rig.yaml", depth="/d/image")


@pytest.mark.parametrize(("given", "found"), [("my_rig.yaml", "'my_rig.yaml'"), (None, "nothing"), ([1], "a list")])
def test_a_rig_that_is_named_without_its_key_is_refused(given: object, found: str) -> None:
    """A launch began its processes again and again, of which each ended in a traceback."""
    nothing, sections = SimpleNamespace(), {EVERY_NODE: {"rig": given}}
    setup = Setup("twin", nothing, nothing, nothing, sections, "cell.yaml", lambda: None, lambda: ())
    words = rf"cell.yaml: /\*\*: rig: expected keys and values such as {{file: my_rig.yaml}}, found {found}"
    with pytest.raises(ParameterError, match=words):
        setup.rig()


@pytest.mark.parametrize("key", ["image", "depth"])
@pytest.mark.parametrize("name", ["*", "a b", "image_raw ", "a//b", "image_raw/", "/{camera}/a?b", "x#y"])
def test_what_is_no_name_of_a_topic_is_refused(key: str, name: str) -> None:
    """Zenoh refused it node by node, and a launch tried again and again; or nobody was ever heard, and nobody told."""
    with pytest.raises(GraphError, match=f"{key}: expected the name of a topic below /<camera>/ such as image_raw"):
        RigParameters("rig.yaml", **{key: name})


def test_only_depth_may_have_no_topic() -> None:
    assert RigParameters("rig.yaml", depth="").depth == ""
    with pytest.raises(GraphError, match=r"image: expected the name of a topic .* found ''"):
        RigParameters("rig.yaml", image="")


@pytest.mark.parametrize("node", ["player", EVERY_NODE])
def test_a_log_that_is_played_under_other_names_is_looked_at_under_these(tmp_path: Path, node: str) -> None:
    """In lockstep it was; in a launch of processes its cameras were not found by the rig's names, or never heard.

    Nor where the names were said of every node, and so of the player.
    """
    log = str(tmp_path / "log.mcap")
    with LogWriter(log) as written:
        written.write("/eye/image_raw", convert.raw_image("eye", 5, np.zeros((48, 64, 3), np.uint8)), 5)
    save_rig(RigFile(Rig((CAMERA,))), tmp_path / "rig.yaml")
    player = {"log": log, "remap": ["/eye/image_raw:=/left/image_raw"]}
    rig = {"rig": {"log": log, "file": str(tmp_path / "rig.yaml")}}
    sections = {EVERY_NODE: rig, "player": {}} | {node: player | (rig if node == EVERY_NODE else {})}
    nothing = SimpleNamespace()
    setup = Setup("twin", nothing, nothing, nothing, sections, "test", lambda: None, lambda: ())
    assert read_rig(setup.rig()).cameras[0].image == "/left/image_raw"
    other = {**sections, "player": {"log": "other.mcap"}}
    assert not replace(setup, sections=other).rig().remap


@pytest.mark.parametrize(("reference_s", "live"), [(11, False), (1_767_312_000, True)])
@pytest.mark.parametrize("rate_ppm", [0.0, 3.0])
def test_clocks_of_a_recording_that_counts_from_its_start_are_not_those_of_live_images(
    tmp_path: Path, reference_s: int, live: bool, rate_ppm: float
) -> None:
    """As `calibrate rig` writes them of videos: by a few ppm all but the first camera were hours off, and left out."""
    clock = (250_000_000, rate_ppm, reference_s * 10**9)
    camera = replace(CAMERA, **dict(zip(("time_offset_ns", "time_rate_ppm", "time_reference_ns"), clock, strict=True)))
    save_rig(RigFile(Rig((camera,))), tmp_path / "rig.yaml")
    (read,) = read_rig(RigParameters(file=str(tmp_path / "rig.yaml"))).rig.cameras
    stamp = 1_767_312_000 * 10**9
    assert read.rig_time(stamp) == stamp + (250_000_000 if live else 0)
