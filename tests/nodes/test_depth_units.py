"""Depth in another unit than its encoding says: space would be free for kilometres."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

from twin_node.bag import LogWriter, open_log
from twin_node.messages.convert import depth_from_message, depth_image
from twin_node.nodes.log_check import check_log
from twin_node.nodes.log_source import LogSession

DEPTH = "/cam_left/depth/image_rect"


@pytest.mark.parametrize(("times", "median"), [(1000.0, "e+03 m"), (0.001, "0.00"), (0.0, None), (1.0, None)])
def test_a_replay_is_told_of_it_too(
    times: float, median: str | None, cell_log: Callable[..., Path], tmp_path: Path
) -> None:
    """`check` alone told. An image in which nothing is known tells nothing."""
    path = tmp_path / "log.mcap"
    with open_log(cell_log(0.3)) as read, LogWriter(path) as log:
        for entry in read.messages():
            message = entry.message
            if entry.topic == DEPTH:
                depth = depth_from_message(message)
                message = depth_image("cam_left", entry.stamp, np.float32(times) * depth)
                message.header = entry.message.header
            log.write(entry.topic, message, entry.stamp)
    with LogSession(path) as session:
        told = [line for line in session.set_doubts if "the unit is wrong" in line]
    with open_log(path) as read:
        found = [fault for topic in check_log(read).topics for fault in topic.faults if "the unit is wrong" in fault]
    assert len(told) == len(found) == (median is not None)
    for line in told:
        assert line.startswith(f"camera 'cam_left': {DEPTH} begins with a median depth of ")
        assert str(median) in line
        assert line.endswith(f"--remap {DEPTH}:=/unmeasured{DEPTH}")
