"""What a report leaves on the disk."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import numpy as np
import pytest

from twin_node.forecast import ForecastQuality
from twin_node.forecast.comparison import Score
from twin_node.model import WindowModel
from twin_node.nodes.chain_parameters import ChainParameters
from twin_node.nodes.collector import CollectorNode
from twin_node.nodes.log_source import LogSession
from twin_node.nodes.player import Span
from twin_node.nodes.replay import Run
from twin_node.nodes.report.figures import figures_of
from twin_node.nodes.report.foresight import Foresight
from twin_node.nodes.report.page import ReportError, _cards, _curves, _lead, _page, _write
from twin_node.nodes.report.quality import LeftOut, Quality
from twin_node.nodes.set_contents import SetContents
from twin_node.nodes.spool import Spool, Tick
from twin_node.nodes.topics import FRAMES, JOINT_STATES, TRAJECTORY
from twin_node.rig.drift_report import Drift, DriftReport, Verdict
from twin_node.runtime.bus import LocalBus
from twin_node.runtime.clock import SteppedClock
from twin_node.scene import Camera, FrameSet, Separation, View


def short_run() -> Run:
    """One whose only forecast has not come due: its figures are not numbers, or infinite."""
    collector = CollectorNode(LocalBus(), SteppedClock(), None)
    collector.quality = ForecastQuality(float("nan"), 0.99, 0.1, 0.5, np.zeros(6))
    collector.separations = [Separation.without_pair(0, 0, 1.0, "clear")]
    model = cast(WindowModel, None)
    return Run(ChainParameters(), 1, 1, 0, 0.1, 100.0, 1000.0, model, 10, collector, None, None)


def test_cameras_that_most_sets_had_to_do_without_are_named() -> None:
    """Of a log in which one camera has another clock than the others all sets were made of it alone, in silence."""
    held = SetContents()
    held.sets, held.images = 10, Counter(a=10, b=2)
    assert [line.split(": its")[0] for line in held.lacking("abc", ())] == [
        "camera b: in only 2 of 10 sets",
        "camera c: in only 0 of 10 sets",
    ]
    assert not any("--rate" in line for line in held.lacking("abc", ()))
    assert held.lacking("ab", (), damaged={"b": 3}) == (), "they were there, but damaged"
    assert len(held.lacking("ab", (), damaged={"b": 2, "a": 9})) == 1
    assert all(
        line.endswith("; or 50 times the recording's speed is too fast here: lower --rate")
        for line in held.lacking("abc", (), 50.0)
    )


@pytest.mark.parametrize(("period_s", "stops_after", "is_told"), [(0.1, 25, True), (0.1, 32, False), (1.0, 37, False)])
def test_a_camera_that_stops_is_named_though_most_sets_have_it(
    period_s: float, stops_after: int, is_told: bool
) -> None:
    held, image = SetContents(), np.zeros((1, 1, 3), np.uint8)
    cameras = [Camera(name, 1, 1, np.eye(3), np.eye(4)) for name in "ab"]
    for number in range(40):
        stamp = round(number * period_s * 1e9)
        there = cameras if number < stops_after else cameras[:1]
        held.add(FrameSet(stamp, tuple(View(camera, stamp, image) for camera in there)), stamp)
    told = held.lacking("ab", ())
    assert bool(told) == is_told
    assert held.lacking("ab", (), damaged={"b": 14}) == told
    assert held.lacking("ab", (), damaged={"b": 15}) == (), "those of the last sets may have been damaged"
    assert all(line.startswith("camera b: in none of the last 15 sets, 1.5 s: it stopped") for line in told)


@pytest.mark.parametrize("damage", [None, "read up to byte 7"])
def test_a_run_whose_sets_end_before_its_log_says_so(damage: str | None) -> None:
    """Where damage has ended the log, that is told instead."""
    run = replace(short_run(), damage=damage)
    run.collector.configure()
    cast(SteppedClock, run.collector.clock).advance_to(2_000_000_000)
    run.collector.bus.publish(FRAMES, FrameSet(1, ()))
    session = cast(LogSession, SimpleNamespace(span=Span(0, 5_000_000_000), cameras_in_sets=(), cameras=()))
    told = run.missed(session)
    assert len(told) == (damage is None)
    assert all(line.startswith("no set of images in the last 3.0 s of the log, after 1: ") for line in told)


def unknown_in(figures: Mapping[str, Any]) -> Iterator[str]:
    """Names of figures that are null, however deep."""
    for name, value in figures.items():
        if isinstance(value, Mapping):
            yield from (f"{name}.{inner}" for inner in unknown_in(value))
        elif value is None:
            yield name


@pytest.mark.parametrize("rate", [None, 1.0])
def test_what_could_not_be_measured_is_null_and_has_a_reason(rate: float | None) -> None:
    with Spool(0, 10**9, 30.0) as spool:
        run = replace(short_run(), rate=rate, bytes_per_frame=float("nan"), spool=spool)
        score = Score(0.9, 0.9, 0.9, 0.9, 10.0, 5.0, 1.0, None, 20.0)
        foresight = Foresight({"ours": score, "persistence": score}, "/truth/occupancy", recalls=((0, 0.9),))
        figures = figures_of(run, Quality(), {"left": LeftOut(None, 20.0)}, foresight, 0)
    unknown = set(unknown_in(figures))
    assert {"forecast.coverage", "arm.min_distance_m", "quality.psnr_db"} <= unknown
    assert {"forecast.iou", "forecast.baselines.persistence.iou"} <= unknown
    assert {"latency_ms.p50", "work_ms.p99", "bytes_per_frame", "quality.left_out.left.psnr_moving_db"} <= unknown
    assert unknown == set(figures["reasons"])
    assert figures["forecast"]["coverage_target"] == 0.99
    assert "near" in figures["reasons"]["arm.min_distance_m"]


def test_a_figure_beside_a_known_recall_is_not_for_lack_of_motion() -> None:
    """Where the twin itself saw nothing move in time, but the truth knows what did, an overlap was said to be unknown
    because nothing had moved."""
    score = Score(0.9, 0.9, 0.9, 0.9, 10.0, 5.0, 1.0, None, 20.0)
    told = [
        figures_of(short_run(), Quality(), {}, Foresight(methods, "/truth/occupancy"), 0)["reasons"]["forecast.iou"]
        for methods in ({"ours": score}, {"ours": replace(score, recall=None)})
    ]
    assert "(/truth/occupancy) cannot tell" in told[0]
    assert told[1] == "nothing moved at a time that had been foreseen"


def test_what_the_drift_watch_saw_is_told_by_the_time_of_the_span() -> None:
    """As pictures and curves are: where the first set came 5 s after the arm's joints it was told 5 s too early."""
    run, second = short_run(), 10**9
    for seconds, verdict in ((5, Verdict.STEADY), (7, Verdict.BUMPED)):
        stamp = (100 + seconds) * second
        run.collector.drift.append(DriftReport(stamp, (Drift("left", verdict, 0.3, 0.5, 40, stamp),)))
    changes = figures_of(run, Quality(), {}, Foresight(), 100 * second)["cameras"]["left"]["changes"]
    assert [(change["at_s"], change["verdict"]) for change in changes] == [(7.0, "bumped")]


@pytest.mark.parametrize("topic", [None, JOINT_STATES, TRAJECTORY])
def test_a_made_up_arm_is_called_so(topic: str | None) -> None:
    """Distances to an arm that is not there stood beside the pictures of a cell without one."""
    run, session = short_run(), SimpleNamespace(span=SimpleNamespace(seconds=1.0), rig=SimpleNamespace(cameras=()))
    run.collector.configure()
    run.collector.activate()
    if topic is not None:
        run.collector.bus.publish(topic, object())
    figures = figures_of(run, Quality(), {}, Foresight(), 0)
    labels = [card["label"] for card in _cards(figures)]
    told = ["made-up ur10e" in _lead(cast(LogSession, session), run), figures["arm"]["is_made_up"]]
    told += [f"smallest distance to {whose} arm" in labels for whose in ("a made-up", "the")]
    told.append(figures["reasons"]["quality.psnr_arm_db"] == "nothing is told of an arm")
    assert told == [topic is None, topic is None, topic is None, topic is not None, topic is None]


def test_a_page_about_the_folder_that_one_is_in_has_a_name(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """`twin_node replay .` made one without title and heading."""
    (tmp_path / "cell").mkdir()
    monkeypatch.chdir(tmp_path / "cell")
    run, log = short_run(), SimpleNamespace(path=Path())
    run.collector.stamps, run.collector.tier_counts = [0], [[1, 0, 0, 0, 0]]
    session = SimpleNamespace(log=log, span=Span(0, 10**9), rig=SimpleNamespace(cameras=()))
    figures = figures_of(run, Quality(), {}, Foresight(), 0)
    page = _page(cast(LogSession, session), run, figures, (), Foresight())
    assert "<title>twin_node: cell</title>" in page and "<h1>cell</h1>" in page


def test_where_nothing_came_due_no_empty_chart_promises_it() -> None:
    run = short_run()
    run.collector.stamps, run.collector.tier_counts = [0], [[1, 0, 0, 0, 0]]
    drawn = [[curve.caption for curve in _curves(run, Foresight(recalls=recalls), 0)] for recalls in ((), ((0, 1.0),))]
    assert [len(captions) for captions in drawn] == [3, 4]


def test_the_first_set_of_lockstep_builds_the_model_and_is_no_work_per_set() -> None:
    run = short_run()
    run.collector.work_ms = [9000.0, 20.0, 20.0]
    assert figures_of(run, Quality(), {}, Foresight(), 0)["latency_ms"]["p99"] == 20.0


@pytest.mark.parametrize(("seconds", "is_told"), [(10, False), (3600, True)])
def test_a_page_says_how_much_of_a_long_run_was_scored(seconds: int, is_told: bool) -> None:
    session = SimpleNamespace(span=SimpleNamespace(seconds=float(seconds)), rig=SimpleNamespace(cameras=()))
    with Spool(0, seconds * 1_000_000_000, 30.0) as spool:
        spool.add(Tick(FrameSet(stamp=0, views=(), sequence=0)))
        run = replace(short_run(), spool=spool)
        assert figures_of(run, Quality(), {}, Foresight(), 0)["scored"] == 1
        lead = _lead(cast(LogSession, session), run)
    assert ("scored on 1 set, in blocks of a second" in lead) is is_told


@pytest.mark.parametrize("error", [KeyboardInterrupt(), OSError(28, "No space left on device")])
def test_a_report_that_breaks_off_leaves_what_was_there(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: BaseException
) -> None:
    (tmp_path / "report.json").write_text("old")
    write = Path.write_text

    def refuse(path: Path, text: str, encoding: str) -> int:
        written = write(path, text[:1], encoding=encoding)
        if path.name.startswith("report.html"):
            raise error
        return written

    monkeypatch.setattr(Path, "write_text", refuse)
    with pytest.raises(KeyboardInterrupt if isinstance(error, KeyboardInterrupt) else ReportError):
        _write(tmp_path, {"report.json": "new", "report.html": "new"})
    assert [(path.name, path.read_text()) for path in tmp_path.iterdir()] == [("report.json", "old")]
