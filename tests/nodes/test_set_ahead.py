"""A camera's clock that is set ahead within a log: its images are left out from then on, as live."""

from __future__ import annotations

import warnings
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin_node.bag import LogWriter, write_rig
from twin_node.messages.convert import camera_info, compressed_image
from twin_node.nodes.log_source import LogSession, LogSource
from twin_node.nodes.set_ahead import ClocksSetAhead
from twin_node.nodes.set_contents import SetContents
from twin_node.nodes.synchronizer import SynchronizerParameters
from twin_node.scene import FrameSet, Rig, RigCamera

START, MS = 1_700_000_000_000_000_000, 1_000_000
PERIOD = 33 * MS
LEFT = RigCamera("left", 32, 24, np.array([[30.0, 0, 16], [0, 30, 12], [0, 0, 1]]), np.eye(4))
CAMERAS = (LEFT, replace(LEFT, name="right"), replace(LEFT, name="top"))
DARK = np.zeros((24, 32, 3), np.uint8)


def log_with_clocks_set(path: Path, names: Collection[str], at: int, ahead_ms: int) -> Path:
    """2 s of images; from one on, some cameras' stamps are ahead."""
    box = np.array([[-1.0, -1, 0], [1, 1, 1]])
    with LogWriter(path) as log:
        write_rig(log, Rig(CAMERAS, box), START)
        for k in range(60):
            for camera in CAMERAS:
                taken = START + k * PERIOD
                stamp = taken + (ahead_ms * MS if camera.name in names and k >= at else 0)
                log.write(f"/{camera.name}/camera_info", camera_info(camera, stamp), taken)
                image = compressed_image(camera.name, stamp, DARK)
                log.write(f"/{camera.name}/image_raw/compressed", image, taken + 20 * MS)
    return path


@pytest.mark.filterwarnings("ignore::twin_node.errors.TwinWarning")
def test_the_others_keep_their_sets(tmp_path: Path) -> None:
    """All sets were made of that camera alone: by its stamps the others' images were late."""
    with LogSession(log_with_clocks_set(tmp_path / "log.mcap", ["top"], 30, 500)) as session:
        sets = [[view.camera.name for view in frames.views] for frames in LogSource(session, SynchronizerParameters())]
    assert sets[:29] == [["left", "right", "top"]] * 29
    assert sets[32:] == [["left", "right"]] * len(sets[32:])
    assert len(sets) >= 55


def test_sets_that_end_with_the_clock_of_all_cameras_are_told(tmp_path: Path) -> None:
    """Two thirds of a log were left out in silence, by what makes something of it and by a replay."""
    log = log_with_clocks_set(tmp_path / "log.mcap", ["left", "right", "top"], 20, 3_600_000)
    with LogSession(log) as session, warnings.catch_warnings(record=True) as told:
        assert len(list(LogSource(session, SynchronizerParameters()))) == 20
    assert any("no set of images in the last 1.3 s of the log, after 20: all cam" in str(one.message) for one in told)


@pytest.mark.parametrize(("period_s", "until_s", "is_told"), [(0.1, 5.2, True), (0.1, 4.8, False), (60, 2600, False)])
def test_sets_that_come_seldom_have_not_ended(period_s: float, until_s: float, is_told: bool) -> None:
    held = SetContents()
    for number in range(40):
        held.add(FrameSet(number, ()), round(number * period_s * 1e9))
    assert (held.ended_before(round(until_s * 1e9)) is not None) == is_told


def found(*images: tuple[int, int]) -> list[int]:
    """How far ahead a camera was set, ms, by each image after a regular second; stamps and recordings, ms."""
    clocks = ClocksSetAhead()
    regular = [(k * 33, k * 33 + 50) for k in range(-30, 0)]
    told = [clocks.ahead_ns("a", stamp * MS, recorded * MS) // MS for stamp, recorded in (*regular, *images)]
    assert told[:30] == [0] * 30
    return told[30:]


def test_what_was_recorded_late_is_no_clock_that_was_set() -> None:
    assert found((500, 50), (533, 83)) == [500, 500]
    assert found((0, 50), (533, 83), (566, 116)) == [0, 500, 500]
    assert found((500, 550), (533, 583)) == [0, 0]  # images were lost
    assert found((0, 550), (33, 551), (66, 552), (99, 553), (132, 554), (530, 580)) == [0] * 6  # a slow disk
    assert found((0, 550), (530, 580)) == [0, 0]  # the same, and its queue was full


def test_a_clock_that_is_set_twice_is_followed() -> None:
    assert found((500, 50), (1533, 83), (1566, 116)) == [500, 1500, 1500]


def test_images_of_a_slow_camera_that_catch_up_are_no_clock_that_was_set() -> None:
    """All had been recorded late until then, so none had ever been as far ahead."""
    clocks, recorded, told = ClocksSetAhead(), 0, []
    for k in range(40):
        recorded = max(200 * k + (600 if k < 20 else 5), recorded + 1)
        told.append(clocks.ahead_ns("a", 200 * k * MS, recorded * MS))
    assert told == [0] * 40
