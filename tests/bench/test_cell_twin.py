"""The real chain in the closed loop: it sees the arm where the loop has driven it, and answers when it is done."""

from __future__ import annotations

import gc
from dataclasses import replace

import numpy as np
import pytest

from twin_node.arm import ArmCollisionChecker
from twin_node.bench.cell_case import CellCase
from twin_node.bench.cell_twin import BySight, Pace, TwinPerception, TwinTiming, run_twin
from twin_node.cell.closed_loop import STEP_NS, LoopParameters
from twin_node.cell.program import RunningProgram
from twin_node.cell.scenario import Scenario
from twin_node.cell.scenario_file import load_scenario
from twin_node.nodes.chain_parameters import ChainParameters, load_parameters
from twin_node.robot import forward_kinematics, place_capsules
from twin_node.scene import ObstacleKind, Obstacles


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    cross = load_scenario("cross")
    return replace(cross, duration_s=0.3, sensing=replace(cross.sensing, width=96, height=72))


def briefly_fitted() -> ChainParameters:
    """The chain as shipped, but for a shorter first fit."""
    chain = load_parameters(None)
    return replace(chain, model=replace(chain.model, seed=replace(chain.model.seed, steps=10)))


def test_the_chain_answers_after_its_latency(scenario: Scenario) -> None:
    run = run_twin(CellCase(scenario, 33.0, LoopParameters()), width=96, pace=Pace.of(50.0))
    assert gc.get_freeze_count() == 0, "a chain that has not been stopped is never freed: 100 MB a run"
    assert run.timing.sets >= 3
    assert run.timing.dropped + run.timing.sets <= 12
    assert run.timing.latencies_ms[1:] == pytest.approx(50.0, abs=1.0)
    evidence = [decision.evidence_stamp for decision in run.record.decisions]
    assert evidence == sorted(evidence)
    ages_ms = [(decision.stamp - decision.evidence_stamp) / 1e6 for decision in run.record.decisions]
    assert min(ages_ms[4:]) >= 49.9
    assert 0 <= run.first_seen_s < 0.3 or run.first_seen_s == np.inf


def test_sets_may_come_more_often_than_their_latency_lasts(scenario: Scenario) -> None:
    pace = Pace.of(100.0, rate_hz=40.0)
    run = run_twin(CellCase(scenario, 33.0, LoopParameters()), width=96, pace=pace)
    assert run.timing.sets >= 8  # of nine
    assert run.timing.latencies_ms[1:] == pytest.approx(100.0, abs=1.0)
    evidence = sorted({decision.evidence_stamp for decision in run.record.decisions})
    assert len(evidence) >= 5
    assert np.diff(evidence).max() < 40_000_000


def test_measured_latency_is_simulated_time(scenario: Scenario) -> None:
    case = CellCase(scenario, 33.0, LoopParameters())
    seen = TwinPerception(case, briefly_fitted(), None)
    program = RunningProgram(case.arm.cycle, case.table, scenario.start_ns, 0)
    program.tell(1.0)
    known: list[Obstacles] = []
    while program.now < scenario.start_ns + 200_000_000:
        found = seen.look(program)
        known += [] if found is None else [found]
        program.step(STEP_NS)
    assert known
    assert (seen.timing.latencies_ms >= 0).all()
    assert seen.first_seen_ns is None or seen.first_seen_ns >= scenario.start_ns


def test_sight_alone_knows_nothing_of_motion(scenario: Scenario) -> None:
    case = CellCase(replace(scenario, duration_s=0.9), 33.0, LoopParameters())
    seen = BySight(TwinPerception(case, briefly_fitted(), Pace.of(50.0)))
    program = RunningProgram(case.arm.cycle, case.table, scenario.start_ns, 0)
    known: list[Obstacles] = []
    while program.now < scenario.start_ns + 300_000_000:
        found = seen.look(program)
        known += [] if found is None else [found]
        program.step(STEP_NS)
    assert known
    for obstacles in known:
        moving = obstacles.kinds == ObstacleKind.MOVING
        assert (obstacles.valid_to[moving] == obstacles.stamp).all()
        assert not obstacles.velocities.any()
        assert (obstacles.kinds == ObstacleKind.STATIC).any()


def test_the_usual_latency_leaves_the_first_set_out() -> None:
    assert TwinTiming(3, 0, np.array([900.0, 60.0, 80.0])).usual_ms == pytest.approx(70.0)
    assert TwinTiming(1, 0, np.array([900.0])).usual_ms == pytest.approx(900.0)


def test_the_taught_region_holds_the_whole_cycle(scenario: Scenario) -> None:
    case = CellCase(scenario, 33.0, LoopParameters())
    region = case.taught_region
    q = case.arm.positions(scenario.start_ns + np.arange(0, case.arm.cycle.period_ns, 50_000_000))
    ends = place_capsules(case.arm.model, forward_kinematics(case.arm.model, q)).ends
    assert (ends >= region.lower).all()
    assert (ends <= region.upper).all()
    assert ArmCollisionChecker(case.arm.model, max_obstacles=4, allowed=(region,)).model.name == "ur5e"
