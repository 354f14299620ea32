"""What a log knows to be true of its moving things."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin_node.bag import LogWriter, open_log
from twin_node.messages import convert
from twin_node.nodes.topics import TRUTH_OCCUPANCY, GraphError
from twin_node.nodes.truth import truth_of
from twin_node.scene import Grid, Occupancy, OccupancyLayer

START, PERIOD = 1_700_000_000_000_000_000, 50_000_000
GRID = Grid(np.zeros(3), 0.02, (10, 10, 10))


def moving(stamp: int, *indices: int) -> Occupancy:
    voxels = np.array(indices, np.uint32)
    layer = OccupancyLayer(0, voxels, np.full(len(voxels), 255, np.uint8))
    nothing = replace(layer, indices=voxels[:0], probability=layer.probability[:0])
    return Occupancy(stamp, stamp, GRID, (layer,), nothing, np.zeros(0, np.uint32))


def test_the_truth_nearest_in_time_holds_and_none_far_from_any(tmp_path: Path) -> None:
    with LogWriter(tmp_path / "log.mcap") as log:
        for number in range(3):
            seen = convert.occupancy_to_message(moving(START + number * PERIOD, number, 100))
            log.write(TRUTH_OCCUPANCY, seen, START + number * PERIOD)
    with open_log(tmp_path / "log.mcap") as read:
        truth = truth_of(read)
    for late in (-24_000_000, 0, 24_000_000):
        points = truth.points(START + PERIOD + late, 0)
        assert points is not None and np.array_equal(GRID.indices(points), [1, 100])
    assert truth.points(START + 2 * PERIOD + 27_000_000, 0) is None
    assert truth.volume_l(START) == pytest.approx(2 * 0.008)


@pytest.mark.parametrize("harm", ["bytes", "values"])
def test_damaged_truth_is_told_with_its_place(tmp_path: Path, harm: str) -> None:
    """It was told as a message of no log."""
    with LogWriter(tmp_path / "log.mcap") as log:
        seen = convert.occupancy_to_message(moving(START, 5))
        log.write(TRUTH_OCCUPANCY, seen, START)
        if harm == "bytes":
            log.write_raw(TRUTH_OCCUPANCY, seen.__msgtype__, b"\0\1\0\0\xff\xff", START + PERIOD)
        else:
            seen.voxel_size = -1.0
            log.write(TRUTH_OCCUPANCY, seen, START + PERIOD)
    with open_log(tmp_path / "log.mcap") as read, pytest.raises(GraphError) as told:
        truth_of(read)
    assert str(told.value).startswith(f"{tmp_path / 'log.mcap'}: {TRUTH_OCCUPANCY}, 0.050 s after the log's start: ")
    assert "twin_node check" in str(told.value) and "--start-offset" not in str(told.value)
