"""The twin as a node of a graph: what it says of itself."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twin_node.nodes.live.setup import Setup
from twin_node.nodes.live.twin import make_twin
from twin_node.nodes.topics import FRAMES, kind_of
from twin_node.rig import DecodedImage, FrameAssembler, RigFile, save_rig
from twin_node.runtime.clock import SystemClock
from twin_node.runtime.executor import Executor
from twin_node.runtime.wire import LocalWire
from twin_node.runtime.wire_bus import WireBus
from twin_node.scene import Rig, RigCamera


def test_a_twin_that_waits_in_the_dark_says_so(tmp_path: Path) -> None:
    """No forecast went out, the arm stood, and nothing that anybody hears told of the lenses' caps."""
    K = np.array([[20.0, 0, 7.5], [0, 20.0, 5.5], [0, 0, 1]])
    front = RigCamera("front", 16, 12, K, np.eye(4))
    workspace = np.array([[-1.0, -1.0, 0.0], [1.0, 1.0, 1.0]])
    save_rig(RigFile(Rig((front,), workspace)), tmp_path / "rig.yaml")
    wire, executor = LocalWire(), Executor()
    bus = WireBus(wire, executor, "twin", kind_of)
    sections = {"/**": {"rig": {"file": str(tmp_path / "rig.yaml")}}, "model": {"own_process": False}}
    node = make_twin(Setup("twin", bus, SystemClock(), executor, sections, "test", executor.stop, tuple))
    node.configure()
    node.activate()
    assert node.diagnoses() == ()
    black = DecodedImage(SystemClock().now(), np.zeros((12, 16, 3), np.uint8))
    frames = FrameAssembler([front]).assemble({"front": black})
    wire.publisher("synchronizer", FRAMES, kind_of(FRAMES))(frames)
    while executor.step(0.0):
        pass
    (told,) = node.diagnoses()
    assert told.name == "model: light"
    assert "all cameras have shown nothing" in told.message
    node.deactivate()
    node.cleanup()
