"""A camera bumped in a recording: named in diagnostics and status, left out of model and forecast until put back."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from quick_reports import without_left_out

from twin_node.bag import open_log
from twin_node.cell import CellSource, load_scenario
from twin_node.cell.scenario import Fault
from twin_node.cli import main
from twin_node.messages import convert, header_stamp
from twin_node.model import ModelParameters, WindowModel
from twin_node.model.parameters import SeedParameters
from twin_node.nodes.drift import DriftNode
from twin_node.nodes.topics import DIAGNOSTICS, FRAMES, OCCUPANCY, STATUS, TRUSTED_FRAMES
from twin_node.rig.drift import DriftParameters
from twin_node.robot import ur_model
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import Clock, SteppedClock, SystemClock
from twin_node.scene import Camera, FrameSet, View

BUMPED = Fault("bumped", "cam_left", 0.8, 2.2)
SECONDS, RATE_HZ = 3.4, 10.0


@pytest.fixture(scope="module")
def replayed(cell_log: Callable[..., Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Folder with the log and the report of a replay in which one camera is bumped, and put back."""
    folder = tmp_path_factory.mktemp("bumped")
    log = cell_log(SECONDS, BUMPED, rate_hz=RATE_HZ, width=192, height=144)
    (folder / "small.yaml").write_text(
        "model: {ros__parameters: {seed: {steps: 10}, track: {steps: 1}, map: {steps: 0}}}"
    )
    arguments = ["--lockstep", "--width", "96", "--params", str(folder / "small.yaml"), "--report", str(folder)]
    with without_left_out():
        assert main(["replay", str(log), "-o", str(folder / "out.mcap"), *arguments]) == 0
    return folder


def test_the_camera_is_named_in_diagnostics_within_a_second_and_cleared(replayed: Path) -> None:
    with open_log(replayed / "out.mcap") as log:
        messages = [m.message for m in log.messages([DIAGNOSTICS])]
        start = log.start_ns
    levels = {
        (header_stamp(m) - start) / 1e9: {d.hardware: d.level for d in convert.diagnostics_from_message(m)}
        for m in messages
    }
    errors = [at for at, cameras in levels.items() if cameras["cam_left"] == convert.Level.ERROR]
    assert BUMPED.from_s < min(errors) <= BUMPED.from_s + 1
    assert max(errors) < SECONDS
    assert levels[max(levels)]["cam_left"] == convert.Level.OK
    assert all(
        level == convert.Level.OK
        for cameras in levels.values()
        for name, level in cameras.items()
        if name != "cam_left"
    )
    named = next(d for m in messages for d in convert.diagnostics_from_message(m) if d.level == convert.Level.ERROR)
    readings = {reading.key: float(reading.value) for reading in named.readings}
    assert readings["turn_deg"] == pytest.approx(1.0, abs=0.15)
    assert readings["features"] > 15


def test_status_and_report_say_it(replayed: Path) -> None:
    with open_log(replayed / "out.mcap") as log:
        statuses = [convert.status_from_message(m.message) for m in log.messages([STATUS])]
    assert any("camera cam_left has moved" in warning for status in statuses for warning in status.warnings)
    figures = json.loads((replayed / "report.json").read_text())["cameras"]
    assert [change["verdict"] for change in figures["cam_left"]["changes"]] == ["bumped", "steady"]
    assert figures["cam_left"]["left_out_sets"] > 0.7 * RATE_HZ
    assert all(not figures[name]["changes"] for name in figures if name != "cam_left")
    assert "cam_left: bumped at" in (replayed / "report.html").read_text()


def test_what_it_alone_frees_is_unknown_meanwhile(replayed: Path) -> None:
    with open_log(replayed / "out.mcap") as log:
        occupancies = [convert.occupancy_from_message(m.message) for m in log.messages([OCCUPANCY])]
        start = log.start_ns
    unknown = np.array([[(o.stamp - start) / 1e9, o.unknown_runs[:, 1].sum()] for o in occupancies])
    before = unknown[unknown[:, 0] < BUMPED.from_s, 1]
    meanwhile = unknown[(unknown[:, 0] > BUMPED.from_s + 1) & (unknown[:, 0] < BUMPED.to_s), 1]
    assert np.median(meanwhile) > 1.1 * np.median(before)


def frames_of(images: dict[str, np.ndarray], stamp: int) -> FrameSet:
    K = np.array([[100.0, 0, 64], [0, 100, 48], [0, 0, 1]])
    views = tuple(View(Camera(name, 128, 96, K, np.eye(4)), stamp, image) for name, image in images.items())
    return FrameSet(stamp, views)


def test_without_a_camera_to_trust_nothing_goes_on_and_diagnostics_do() -> None:
    scene = np.random.default_rng(0).integers(0, 255, (24, 40, 3), dtype=np.uint8).repeat(5, 0).repeat(5, 1)
    bus, passed, told = LocalBus(), [], []
    node = DriftNode(bus, SteppedClock(), DriftParameters())
    bus.subscribe(TRUSTED_FRAMES, passed.append)
    bus.subscribe(DIAGNOSTICS, told.append)
    node.configure()
    node.activate()
    for i in range(40):
        shift = 3 if i >= 10 else 0
        image = np.ascontiguousarray(scene[:96, shift : shift + 128])
        bus.publish(FRAMES, frames_of({"left": image, "right": image}, (i + 1) * 100_000_000))
    assert 10 < len(passed) < 20
    assert {int(status.level) for status in told[-1].status} == {convert.Level.ERROR}
    assert header_stamp(told[-1]) > 3_000_000_000


def test_without_its_newest_camera_no_set_goes_back() -> None:
    """The other one's image of the same set may be older than what went on before."""
    scene = np.random.default_rng(0).integers(0, 255, (24, 40, 3), dtype=np.uint8).repeat(5, 0).repeat(5, 1)
    bus, passed = LocalBus(), list[FrameSet]()
    node = DriftNode(bus, SteppedClock(), DriftParameters())
    bus.subscribe(TRUSTED_FRAMES, passed.append)
    node.configure()
    node.activate()
    for i in range(40):
        shift, stamp = (3 if i >= 10 else 0), (i + 2) * 100_000_000
        still, moved = (np.ascontiguousarray(scene[:96, at : at + 128]) for at in (0, shift))
        frames = frames_of({"late": still, "right": moved}, stamp)
        late = replace(frames.views[0], stamp=stamp - 150_000_000)
        bus.publish(FRAMES, replace(frames, views=(late, *frames.views[1:])))
    stamps = [frames.stamp for frames in passed]
    assert len(passed[0].views) == 2 and len(passed[-1].views) == 1
    assert stamps == sorted(stamps)


def test_a_recording_whose_clock_begins_at_0_keeps_its_first_set() -> None:
    """So begin the stamps of imported videos that say how many frames there are per second."""
    bus, passed = LocalBus(), []
    node = DriftNode(bus, SteppedClock(), DriftParameters())
    bus.subscribe(TRUSTED_FRAMES, passed.append)
    node.configure()
    node.activate()
    image = np.zeros((96, 128, 3), np.uint8)
    for stamp in (0, 100_000_000):
        bus.publish(FRAMES, frames_of({"left": image}, stamp))
    assert [frames.stamp for frames in passed] == [0, 100_000_000]


@pytest.mark.parametrize(
    ("clock", "begins_s", "is_left_out"),
    [(SystemClock, 30, True), (SystemClock, 90, True), (SteppedClock, 30, False)],
    ids=["clock put back", "process ended", "log begun again"],
)
def test_a_camera_that_was_moved_stays_out_where_the_node_is_made_anew(
    tmp_path: Path, clock: Callable[[], Clock], begins_s: int, is_left_out: bool
) -> None:
    """In the same process or in another one, which knows only what was left to it; a log begins with its cameras in
    place."""
    scene = np.random.default_rng(0).integers(0, 255, (24, 40, 3), dtype=np.uint8).repeat(5, 0).repeat(5, 1)
    home, moved = (np.ascontiguousarray(scene[:96, shift : shift + 128]) for shift in (0, 3))
    last: list[FrameSet] = []
    nodes = []
    for run_s in (60, begins_s):
        bus = LocalBus()
        nodes.append(DriftNode(bus, clock(), DriftParameters(), tmp_path))
        bus.subscribe(TRUSTED_FRAMES, last.append)
        nodes[-1].configure()
        nodes[-1].activate()
        for i in range(20):
            left = home if run_s == 60 and i < 5 else moved
            bus.publish(FRAMES, frames_of({"left": left, "right": home}, run_s * 10**9 + i * 100_000_000))
    assert len(last) == 40
    assert [len(frames.views) for frames in last[20:]] == [1 if is_left_out else 2] * 20


def test_a_disk_that_takes_nothing_does_not_end_the_watch(tmp_path: Path) -> None:
    bus, passed = LocalBus(), []
    node = DriftNode(bus, SystemClock(), DriftParameters(), tmp_path / "gone")
    bus.subscribe(TRUSTED_FRAMES, passed.append)
    node.configure()
    node.activate()
    bus.publish(FRAMES, frames_of({"left": np.zeros((96, 128, 3), np.uint8)}, 10**9))
    assert len(passed) == 1


def test_a_camera_that_is_left_out_and_comes_back_finds_the_model_working() -> None:
    demo = load_scenario("demo")
    sensing = replace(demo.sensing, width=96, height=72, rate_hz=RATE_HZ)
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=10)), arm=ur_model("ur5e"))
    for i, frames in enumerate(CellSource(replace(demo, duration_s=2.4, sensing=sensing))):
        views = frames.views[1:] if 5 <= i < 17 else frames.views
        state = model.update(replace(frames, views=views, stamp=max(view.stamp for view in views)))
        assert len(state.moving_masks) == len(views)
