"""Our logs read by the Node packages that Foxglove is made of: `npm install @mcap/core @foxglove/rosmsg ...`."""

from __future__ import annotations

import json
import shutil
import subprocess
from pathlib import Path

import numpy as np
import pytest

from twin_node.bag import LogWriter, RecordingWriter
from twin_node.messages import builtin_types, message_type, serialize, to_duration

SCRIPT = Path(__file__).parent / "read_log.cjs"
PACKAGES = ("@mcap/core", "@foxglove/rosmsg", "@foxglove/rosmsg2-serialization")


@pytest.fixture
def node() -> str:
    """The Node program, where the packages are at hand (NODE_PATH, or node_modules in a folder above)."""
    program = shutil.which("node")
    if program is None:
        pytest.skip("node is not installed")
    asked = "".join(f"require.resolve('{package}');" for package in PACKAGES)
    if subprocess.run([program, "-e", asked], cwd=SCRIPT.parent, capture_output=True, check=False).returncode:
        pytest.skip(f"the Node packages {', '.join(PACKAGES)} are not installed (NODE_PATH)")
    return program


@pytest.mark.parametrize("writer", ["log", "recording"])
def test_foxglove_s_packages_read_standard_and_own_messages(tmp_path: Path, node: str, writer: str) -> None:
    path = tmp_path / "log.mcap"
    text = message_type("std_msgs/msg/String")(data="hello")
    layer = message_type("twin_msgs/msg/OccupancyLayer")(
        horizon=to_duration(200_000_000),
        indices=np.array([3, 5, 8], np.uint32),
        probability=np.array([255, 128, 1], np.uint8),
    )
    if writer == "log":
        with LogWriter(path) as log:
            log.write("/chatter", text, 1)
            log.write("/layer", layer, 2)
    else:
        with RecordingWriter(path) as recording:
            for stamp, (topic, message) in enumerate((("/chatter", text), ("/layer", layer)), start=1):
                recording.write(topic, message.__msgtype__, bytes(serialize(message)), stamp, builtin_types())
    ran = subprocess.run([node, str(SCRIPT), str(path)], capture_output=True, text=True, check=True)
    found = json.loads(ran.stdout)
    assert found["profile"] == "ros2"
    assert [(m["topic"], m["stamp"], m["text"]) for m in found["messages"]] == [
        ("/chatter", "1", "hello"),
        ("/layer", "2", None),
    ]
    assert found["messages"][1]["indices"] == [3, 5, 8]
    assert found["messages"][1]["horizon"] == 200_000_000
