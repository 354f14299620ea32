"""The closed-loop benchmark: its names, the order of its policies, its judging of contacts, and what it refuses."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path as FilePath

import numpy as np
import pytest
from matplotlib.figure import Figure

from twin_node import resources
from twin_node.bench import cell, cell_picture, cell_scores
from twin_node.bench.cell_case import PERFECT, CellCase, Policy
from twin_node.bench.cell_picture import draw
from twin_node.bench.cell_scores import score
from twin_node.bench.cell_twin import Pace, TwinRun, TwinTiming
from twin_node.bench.errors import BenchError
from twin_node.bench.rig_speed import measure
from twin_node.bench.simulated_arm import told_of_arm
from twin_node.cell.closed_loop import STEP_NS, LoopParameters, LoopRecord
from twin_node.cell.motion import Path
from twin_node.cell.scenario_file import load_scenario
from twin_node.cli import main
from twin_node.nodes.chain_parameters import load_parameters
from twin_node.robot import forward_kinematics

SHORT = """extends: cell
name: short
duration_s: 1.6
arm: {model: ur5e, workspace: [[0.1, -0.6, 0.0], [0.8, 0.6, 0.5]], cycle: {speed: 2.0, acceleration: 4.0}}
people:
  - name: operator
    shoulder: {positions: [[1.35, 0.35, 0.53]], rpy_deg: [[0, 10, 180]]}
    hand: {positions: [[1.02, 0.35, 0.25]]}
"""


def written(folder: FilePath) -> FilePath:
    (folder / "cell.yaml").write_text(resources.find("sim/cell.yaml").read_text())
    (folder / "short.yaml").write_text(SHORT)
    return folder / "short.yaml"


@pytest.fixture
def short(tmp_path: FilePath) -> FilePath:
    return written(tmp_path)


@pytest.fixture(scope="module")
def results(tmp_path_factory: pytest.TempPathFactory) -> list[cell.CaseResult]:
    return cell.run(cell.CellBenchParameters((str(written(tmp_path_factory.mktemp("cell"))),), seeds=1, processes=1))


def test_report_has_the_promised_names(results: list[cell.CaseResult]) -> None:
    figures = json.loads(json.dumps(cell.summary(results)))
    for name in ("ours", "worst_case", "present_only", "perfect", "unlimited"):
        assert {"contacts", "work", "min_distance_m"} <= set(figures[name])
        assert 0 < figures[name]["work"] <= 1
    assert figures["ours"] == figures["perfect"]
    assert figures["perfect"]["contacts"] == 0
    assert figures["worst_case"]["work"] < figures["perfect"]["work"] <= figures["unlimited"]["work"] + 1e-9
    assert set(figures["scenarios"]) == {"short"}
    assert figures["runs"] == 1
    assert figures["gap_closed"] > 0.5
    assert "short" in cell.table(figures)


def test_a_picture_is_drawn_or_the_reason_given(
    results: list[cell.CaseResult], short: FilePath, tmp_path: FilePath
) -> None:
    parameters = cell.CellBenchParameters((str(short),), seeds=1, processes=1)
    assert draw(results, parameters, tmp_path / "out").stat().st_size > 10_000
    (tmp_path / "file").write_text("")
    with pytest.raises(BenchError, match="choose another folder"):
        draw(results, parameters, tmp_path / "file")


def test_the_legend_hides_no_count_of_contacts(results: list[cell.CaseResult]) -> None:
    """It lay on the bars of whoever is slowed by nothing, which reach to the top, and on what they hit."""
    figure = Figure(figsize=(12, 4), layout="constrained")
    axes = figure.add_subplot()
    cell_picture._draw_work(axes, results)
    figure.draw_without_rendering()
    legend = axes.get_legend()
    assert legend is not None and not legend.get_window_extent().overlaps(axes.get_window_extent())


def test_what_is_drawn_is_as_late_as_what_was_scored(
    results: list[cell.CaseResult], short: FilePath, tmp_path: FilePath, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Beside a twin that was 95 ms late the curves of perfect perception were those of one of 33 ms."""
    late: list[int] = []

    class Drawn(CellCase):
        def run(self, policy: Policy) -> LoopRecord:
            late.append(self.timing.latency_ns)
            return super().run(policy)

    monkeypatch.setattr(cell_picture, "CellCase", Drawn)
    parameters = cell.CellBenchParameters((str(short),), seeds=1, processes=1)
    timed = replace(results[0], timing=TwinTiming(3, 0, np.array([85.0, 95.0, 95.0])))
    for result in (results[0], timed):
        draw([result], parameters, tmp_path / "out")
    assert late == [33_000_000] * 2 + [95_000_000] * 2


def held(case: CellCase, phase_ns: float, share: float) -> LoopRecord:
    """An arm that creeps on at one place of its cycle for the scenario's time."""
    steps = int(case.scenario.duration_s * 1e9) // STEP_NS
    rows = np.arange(steps)
    phases = phase_ns + share * STEP_NS * rows
    stamps = case.scenario.start_ns + STEP_NS * rows
    return LoopRecord(stamps, phases, np.full(steps, share), np.full(steps, share), ())


def test_both_runs_with_the_twins_eyes_assume_the_same_latency(
    short: FilePath, monkeypatch: pytest.MonkeyPatch
) -> None:
    assumed = []

    def run_twin(case: CellCase, width: int, pace: Pace | None, by_sight: bool = False) -> TwinRun:
        assumed.append((by_sight, case.timing.latency_ns))
        return TwinRun(case.run(PERFECT), TwinTiming(3, 0, np.array([85.0, 95.0, 95.0])), first_seen_s=0.0)

    monkeypatch.setattr("twin_node.bench.cell_twin.run_twin", run_twin)
    names = (str(short),)
    parameters = cell.CellBenchParameters(names, latency_ms=85.0, twin=True, same_eyes=True, twin_latency_ms=85.0)
    cell.run_case(cell.Job(str(short), 1, parameters))
    assert assumed == [(False, 85_000_000), (True, 85_000_000)]


def test_contacts_count_where_the_arm_moves(short: FilePath) -> None:
    scenario = load_scenario(short)
    case = CellCase(scenario, 33.0, LoopParameters())
    phase_ns = 0.3 * case.arm.cycle.period_ns
    q = case.joints(held(case, phase_ns, 0.3))
    place = forward_kinematics(case.arm.model, q[len(q) // 2])[-1, :3, 3]
    person = scenario.people[0]
    stand = replace(person.shoulder, positions=(tuple(place + np.array([0.45, 0.1, 0.2])),))
    grasp = replace(person.hand, times_s=(0.4, 0.8), positions=(tuple(place + np.array([0.3, 0.2, 0.3])), tuple(place)))
    person = replace(person, shoulder=stand, hand=grasp)
    touched = CellCase(replace(scenario, people=(person,)), 33.0, LoopParameters())
    moving = score(touched, held(touched, phase_ns, 0.3))
    standing = score(touched, held(touched, phase_ns, 0.0))
    assert moving.contacts == 1
    assert moving.min_distance_m <= 0
    assert (standing.contacts, standing.standing_contacts) == (0, 1)
    unseen = score(touched, held(touched, phase_ns, 0.3), first_seen_s=1.5)
    assert (unseen.contacts, unseen.unwarned_contacts) == (0, 1)
    assert moving.unwarned_contacts == 0


def test_a_stop_is_judged_by_when_it_was_told_and_a_dwell_of_the_program_is_none(
    short: FilePath, monkeypatch: pytest.MonkeyPatch
) -> None:
    case = CellCase(replace(load_scenario(short), people=()), 33.0, LoopParameters())
    going, rows = held(case, 0.3 * case.arm.cycle.period_ns, 0.3), np.arange(200)
    told_at, stands_at = 100, 120
    monkeypatch.setattr(
        case, "share_by_truth", lambda stamp, phase_ns, ahead_ns: 0.9 * (stamp <= going.stamps[told_at])
    )
    for last_moved, false_stops in ((stands_at, 1), (60, 0)):
        record = replace(
            going,
            phases_ns=np.minimum(going.phases_ns, going.phases_ns[last_moved]),
            shares=np.where(rows < stands_at, going.shares, 0.0),
            told=np.where(rows < told_at, going.told, 0.0),
        )
        assert score(case, record).false_stops == false_stops


def test_an_entry_that_nobody_answers_is_slower_than_any(short: FilePath) -> None:
    """One that is answered at once in each of so many runs, and one of the last that never is."""
    scenario = load_scenario(short)
    case = CellCase(replace(scenario, people=()), 33.0, LoopParameters())
    one = replace(score(case, case.run(PERFECT)), delays_s=(0.01,) * 18)
    slow_downs = cell._slow_downs([one, replace(one, delays_s=(0.05,), unanswered=1)])
    assert slow_downs == {"entries": 20, "p50": 10.0, "p95": 50.0, "max": None, "unanswered": 1}
    assert cell._slow_downs([replace(one, delays_s=())])["p50"] is None


def test_slow_downs_are_timed_from_the_entry(short: FilePath) -> None:
    scenario = load_scenario(short)
    reach = Path((0.7, 1.1), ((0.9, 0.4, 0.28), (0.5, 0.24, 0.2)))
    person = replace(scenario.people[0], shoulder=Path((0.0,), ((1.05, 0.35, 0.53),), ((0, 18, 180),)), hand=reach)
    case = CellCase(replace(scenario, people=(person,)), 33.0, LoopParameters())
    outcome = score(case, case.run(PERFECT), with_delays=True)
    assert outcome.unanswered == 0
    assert len(outcome.delays_s) >= 1
    assert all(0 <= delay <= 0.053 for delay in outcome.delays_s)


def test_an_entry_between_two_decisions_is_found_to_a_step(short: FilePath, monkeypatch: pytest.MonkeyPatch) -> None:
    """Of decisions more than two steps apart, steps were passed over, and entries were told some steps late."""
    case = CellCase(load_scenario(short), 33.0, LoopParameters(decision_steps=6))
    still = held(case, 0.0, 1.0)
    record = replace(still, told=np.where(np.arange(len(still.told)) < 30, 1.0, 0.5))
    for entry in range(13, 19):
        monkeypatch.setattr(cell_scores, "_is_forbidden", lambda _case, _record, row, entry=entry: row >= entry)
        outcome = score(case, record, with_delays=True)
        assert outcome.delays_s == pytest.approx(((30 - entry) * STEP_NS * 1e-9,))


def test_what_cannot_be_run_is_refused(short: FilePath, refused: Callable[..., str]) -> None:
    with pytest.raises(BenchError, match="scenario short: expected an arm at work"):
        CellCase(replace(load_scenario(short), arm=None), 33.0, LoopParameters())
    assert "nowhere" in refused("bench", "cell", "nowhere")
    assert "add it" in refused("bench", "cell", short, "--same-eyes")
    assert "bench cell: latency_ms: expected 0 to 10000, found" in refused("bench", "cell", short, "--latency", "1e9")
    assert "--set-rate: expected --twin and --latency beside it" in refused(
        "bench", "cell", short, "--twin", "--set-rate", "20"
    )
    assert "latency_ms: expected 0 to 10000, found 33000000" in refused("bench", "cell", short, "--latency", "33000000")
    with pytest.raises(SystemExit):
        main(["bench", "cell", str(short), "--seeds", "0"])
    (short.parent / "file").write_text("")
    assert "choose another folder" in refused("bench", "cell", short, "--out", short.parent / "file")


@pytest.mark.parametrize(
    ("arguments", "says"),
    [
        (["demo"], "--cameras: expected one scenario, whose cameras are measured, found SHORT demo"),
        (["--twin", "--latency", "20"], "leave out --twin and --latency"),
        (["--seeds", "2", "--unknown", "law"], "leave out --seeds and --unknown"),
        ([], "scenario brief: expected more than a second to measure, found 0.5 s"),
    ],
)
def test_the_speed_of_one_rig_is_measured(
    short: FilePath, refused: Callable[..., str], arguments: list[str], says: str
) -> None:
    brief = short.with_name("brief.yaml")
    brief.write_text("extends: short\nname: brief\nduration_s: 0.5\nsensing: {width: 32, height: 24}\n")
    assert says.replace("SHORT", str(brief)) in refused("bench", "cell", brief, *arguments, "--cameras")
    assert "found all; give one" in refused("bench", "cell", "all", "--cameras")


def test_scenarios_of_one_name_are_refused(short: FilePath, capsys: pytest.CaptureFixture[str]) -> None:
    """Their runs would be told as those of one scenario."""
    other = short.with_name("mine.yaml")
    other.write_text("extends: short\nduration_s: 1.0\n")
    assert main(["bench", "cell", str(short), str(other), "--seeds", "1", "--processes", "1"]) == 2
    told = capsys.readouterr().err
    assert "mine.yaml" in told and "short.yaml" in told and "'short'" in told


@pytest.mark.parametrize(
    "changed",
    [
        "furniture: [{name: block, parts: [{size: [2, 2, 1], position: [0.5, 0, 0.3]}]}]",
        "duration_s: 0.07\nsensing: {rate_hz: 30.0}",
        "duration_s: 0.005\nsensing: {rate_hz: 500.0, jitter_ms: 0.1}",
    ],
    ids=["in its way", "brief", "no step of the loop"],
)
def test_an_arm_that_stands_though_nobody_is_there_is_told(
    short: FilePath, refused: Callable[..., str], changed: str
) -> None:
    """Its work is a share of nothing: a division by zero."""
    still = short.with_name("still.yaml")
    still.write_text(f"extends: short\nname: still\n{changed}\n")
    told = refused("bench", "cell", still, "--seeds", "1", "--processes", "1")
    assert "scenario still: expected an arm that works where nobody is, found that it stands for all" in told


def test_seeds_are_run_in_slices(short: FilePath) -> None:
    short.write_text(SHORT.replace("duration_s: 1.6", "duration_s: 0.3"))
    parameters = cell.CellBenchParameters((str(short),), seeds=2, first_seed=3, processes=1)
    assert [result.seed for result in cell.run(parameters)] == [3, 4]


def test_the_rigs_speed_is_measured(short: FilePath) -> None:
    scenario = load_scenario(short)
    small = replace(scenario, sensing=replace(scenario.sensing, width=32, height=24))
    found = measure(small, threads=2, most_sets=30)
    assert found.rig_hz_best >= found.rig_hz > 0
    assert found.cpu_ms_per_set > 0
    assert (found.cameras, found.width, found.height, found.target_hz) == (3, 32, 24, 30.0)


def test_an_arm_with_a_gripper_works_where_nobody_is() -> None:
    """Where it takes hold and lets go it may touch the table; elsewhere it keeps clear as any."""
    pick = load_scenario("pick")
    case = CellCase(replace(pick, duration_s=5.0), 33.0, LoopParameters())
    assert case.run_unobstructed().progress_s > 4.5
    assert pick.arm is not None
    told = told_of_arm(load_parameters(None), pick).arm
    assert len(told.arm().capsules) == len(case.arm.model.capsules) == len(case.checker.capsule_names)
    low = replace(pick, arm=replace(pick.arm, cycle=replace(pick.arm.cycle, lift_m=0.0)), duration_s=5.0)
    assert CellCase(low, 33.0, LoopParameters()).run_unobstructed().progress_s < 2.0
