"""The arm at work in closed loop: what perfect perception says, how the arm stops, and what it waits for."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin_node.arm import ArmCollisionChecker, stopping_table
from twin_node.cell import Scenario, load_scenario
from twin_node.cell.closed_loop import STEP_NS, LoopParameters, run_loop
from twin_node.cell.oracle import Foresight, Oracle, PerfectPerception, Timing
from twin_node.cell.program import RunningProgram, longest_stop_ns
from twin_node.cell.shadow import Shadow, covering_spheres
from twin_node.cell.shapes import Form, Placed, Shape, cubes_meet
from twin_node.cell.ur_arm import ArmInCell, DrivenArm
from twin_node.cell.world import World
from twin_node.scene import Float64, ObstacleKind, Obstacles

MS = 1_000_000


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return replace(load_scenario("two_people"), duration_s=2.5)


@pytest.fixture(scope="module")
def world(scenario: Scenario) -> World:
    return World(scenario)


@pytest.fixture(scope="module")
def shadow(world: World) -> Shadow:
    start = world.scenario.start_ns
    return Shadow(world, start, start + 3_000 * MS, STEP_NS)


@pytest.fixture(scope="module")
def arm(scenario: Scenario) -> ArmInCell:
    assert scenario.arm is not None
    return ArmInCell(scenario.arm, scenario)


sizes = st.floats(0.02, 0.5)


@given(radius=sizes, length=st.floats(0.0, 1.0), sides=st.tuples(sizes, sizes, sizes), seed=st.integers(0, 99))
def test_covering_spheres_hold_the_shape(radius: float, length: float, sides: tuple[float, ...], seed: int) -> None:
    for shape in (Shape(Form.SPHERE, (radius,)), Shape(Form.CAPSULE, (radius, length)), Shape(Form.BOX, sides)):
        cover = covering_spheres(shape)
        points = np.random.default_rng(seed).uniform(-1, 1, (300, 3)) * shape.half_extents
        inside = points[cubes_meet(Placed(shape, np.eye(4)), points, 0.0)]
        gaps = np.linalg.norm(inside[:, None] - cover.centers, axis=2).min(axis=1) - cover.radius
        assert gaps.max(initial=-1.0) <= 1e-9


@pytest.mark.parametrize(
    "shape", [Shape(Form.BOX, (0.6, 0.4, 0.003)), Shape(Form.BOX, (1.0, 1.0, 0.001)), Shape(Form.CAPSULE, (0.004, 2.0))]
)
def test_thin_things_take_few_spheres(shape: Shape) -> None:
    """A board of 3 mm took 27,200 of them: more than any collision scene of the bench holds."""
    cover = covering_spheres(shape)
    assert len(cover.centers) <= 65
    points = np.random.default_rng(1).uniform(-1, 1, (3000, 3)) * shape.half_extents
    inside = points[cubes_meet(Placed(shape, np.eye(4)), points, 0.0)]
    gaps = np.linalg.norm(inside[:, None] - cover.centers, axis=2).min(axis=1) - cover.radius
    assert len(inside) and gaps.max() <= 1e-9
    assert cover.radius < 0.2 * shape.half_extents.max()


def holds(obstacles: Obstacles, points: Float64, stamp: int) -> bool:
    """Whether moving obstacles that are valid at a time hold all the points [n, 3]."""
    rows = (obstacles.kinds == ObstacleKind.MOVING) & (obstacles.valid_from <= stamp) & (stamp <= obstacles.valid_to)
    gaps = np.linalg.norm(points[:, None] - obstacles.positions[rows], axis=2) - obstacles.sizes[rows, 0] / 2
    return bool((gaps.min(axis=1) <= 1e-6).all())


@pytest.mark.parametrize("ahead", [200 * MS, 120 * MS])
def test_foreseen_obstacles_hold_everybody_for_as_long_as_they_are_valid(
    world: World, shadow: Shadow, ahead: int
) -> None:
    oracle = Oracle(world, shadow, reach_m=50.0)
    begin = world.scenario.start_ns + 1_313 * MS
    foreseen = oracle.foreseen(begin - 33 * MS, begin, ahead, np.zeros((1, 3)))
    for stamp in range(begin, begin + ahead + MS, 9 * MS):
        centres = np.array([solid.placed.T_base_shape[:3, 3] for solid in world.moving(stamp)])
        assert holds(foreseen, centres, stamp)
    assert foreseen.valid_to[foreseen.kinds == ObstacleKind.MOVING].max() == begin + ahead
    assert np.linalg.norm(foreseen.velocities, axis=1).max() > 0.5
    now = oracle.present(begin, np.zeros((1, 3)))
    assert holds(now, np.array([solid.placed.T_base_shape[:3, 3] for solid in world.moving(begin)]), begin)
    assert not now.velocities.any()
    assert (now.kinds == ObstacleKind.STATIC).sum() == len(world.static)


def test_what_is_out_of_reach_is_left_out(world: World, shadow: Shadow) -> None:
    near = Oracle(world, shadow, reach_m=0.5).present(world.scenario.start_ns, np.array([[1.0, 0.3, 0.4]]))
    everything = Oracle(world, shadow, reach_m=50.0).present(world.scenario.start_ns, np.array([[1.0, 0.3, 0.4]]))
    assert 0 < len(near.ids) < len(everything.ids)
    assert set(near.ids) < set(everything.ids)


def test_evidence_is_known_after_its_latency_and_once(world: World, shadow: Shadow, arm: ArmInCell) -> None:
    start = world.scenario.start_ns
    timing = Timing(start, rate_hz=30.0, latency_ns=40 * MS, until_standstill_ns=300 * MS)
    table = stopping_table("ur5e")
    stamps = {}
    for foresight in Foresight:
        seen = PerfectPerception(Oracle(world, shadow, 1.5), arm.model, foresight, timing)
        program = RunningProgram(arm.cycle, table, start, 0)
        looks = []
        for _ in range(40):
            looks.append(seen.look(program))
            program.step(STEP_NS)
        known = [look for look in looks if look is not None]
        assert looks[0] is None
        assert [look.stamp - start for look in known] == [round(tick * 1e9 / 30) for tick in range(len(known))]
        moving = known[0].kinds == ObstacleKind.MOVING
        stamps[foresight] = int(known[0].valid_to[moving].max()) - start
    assert stamps == {Foresight.NONE: 0, Foresight.FORECAST: 240 * MS, Foresight.UNLIMITED: 340 * MS}


def test_a_stop_takes_the_time_of_the_table(arm: ArmInCell) -> None:
    table = stopping_table("ur5e")
    program = RunningProgram(arm.cycle, table, 0, command_latency_ns=24 * MS)
    program.phase_ns = 0.35 * arm.cycle.period_ns
    program.tell(1.0)
    while program.share < 1:
        program.step(STEP_NS)
    program.tell(0.0)
    expected_s = table.stop(program.speeds()).duration_s
    assert 0 < expected_s * 1e9 <= longest_stop_ns(arm.cycle, table)
    begun, phase = program.now, program.phase_ns
    while program.share > 0:
        program.step(STEP_NS)
    taken_s = (program.now - begun) * 1e-9 - 0.024
    assert taken_s == pytest.approx(expected_s, abs=0.25 * expected_s + STEP_NS * 1e-9)
    assert program.phase_ns - phase == pytest.approx((0.024 + taken_s / 2) * 1e9, rel=0.25)


class SteadyStop:
    """Every stop takes 0.2 s."""

    def stop(self, speeds: Float64) -> SimpleNamespace:
        return SimpleNamespace(duration_s=0.2)


def test_a_steady_stop_takes_half_the_way_of_its_time(arm: ArmInCell) -> None:
    program = RunningProgram(arm.cycle, SteadyStop(), 0, command_latency_ns=0)
    program.tell(1.0)
    program.step(STEP_NS)
    assert program.phase_ns == STEP_NS
    program.tell(0.0)
    while program.share > 0:
        program.step(STEP_NS)
    assert program.now == STEP_NS + 200 * MS
    assert program.phase_ns - STEP_NS == pytest.approx(100 * MS)


@pytest.mark.parametrize("latency_ms", [0, 8, 17, 20, 25])
def test_no_command_is_obeyed_for_longer_than_the_reaction(arm: ArmInCell, latency_ms: int) -> None:
    parameters = LoopParameters(command_latency_ms=latency_ms)
    program = RunningProgram(arm.cycle, SteadyStop(), 0, command_latency_ns=latency_ms * MS)
    program.tell(1.0)
    for _ in range(parameters.decision_steps):
        program.step(STEP_NS)
    program.tell(0.0)
    while not 0 < program.share < 1:
        program.step(STEP_NS)
    assert program.now - STEP_NS == round(parameters.reaction_s * 1e9)


def test_the_fastest_of_what_is_underway_is_known_until_it_is_obeyed(arm: ArmInCell) -> None:
    program = RunningProgram(arm.cycle, SteadyStop(), 0, command_latency_ns=2 * STEP_NS)
    told = [program.told]
    for share in (0.8, 0.2, 0.0, 0.0, 0.0):
        program.tell(share)
        told.append(program.told)
        program.step(STEP_NS)
    assert told == [0.0, 0.8, 0.8, 0.8, 0.8, 0.2]


def test_what_is_measured_of_a_program_says_which_way_its_joints_turn(scenario: Scenario, arm: ArmInCell) -> None:
    program = RunningProgram(arm.cycle, SteadyStop(), 0, command_latency_ns=0)
    program.share = 0.5
    slowest = 0.0
    for phase_ns in range(0, arm.cycle.period_ns, 50 * MS):
        program.phase_ns = phase_ns
        there = arm.sample(scenario.start_ns + phase_ns + 4 * MS)
        np.testing.assert_allclose(program.joints.velocities, 0.5 * there.velocities, atol=1e-9)
        slowest = min(slowest, float(program.joints.velocities.min()))
    assert slowest < -0.2


def test_a_driven_arm_tells_the_speed_at_which_it_is_driven(scenario: Scenario, arm: ArmInCell) -> None:
    assert scenario.arm is not None
    driven = DrivenArm(scenario.arm, scenario)
    half_ns, start, fastest = 8 * MS, scenario.start_ns, 0.0
    for step in range(1, 150):
        driven.drive(start + 2 * half_ns * step, half_ns * step)
        now, there = driven.sample(start + 2 * half_ns * step), arm.sample(start + half_ns * step - MS)
        np.testing.assert_allclose(now.velocities, there.velocities / 2, atol=0.02)
        fastest = max(fastest, float(np.abs(now.velocities).max()))
    assert fastest > 0.2


def test_the_arm_waits_for_its_first_obstacles_and_keeps_clear(
    world: World, shadow: Shadow, arm: ArmInCell, scenario: Scenario
) -> None:
    table, checker = stopping_table("ur5e"), ArmCollisionChecker(arm.model, max_obstacles=1024)
    timing = Timing(scenario.start_ns, 30.0, 33 * MS, 300 * MS)
    seen = PerfectPerception(Oracle(world, shadow, 1.5), arm.model, Foresight.FORECAST, timing)
    program = RunningProgram(arm.cycle, table, scenario.start_ns, 20 * MS)
    record = run_loop(program, checker, table, seen, scenario.duration_s, LoopParameters())
    assert len(record.stamps) == int(scenario.duration_s * 1e9) // STEP_NS
    assert (record.shares[record.stamps < scenario.start_ns + 53 * MS] == 0).all()
    assert np.all(np.diff(record.phases_ns) >= 0)
    assert record.progress_s > 0.2
    assert any(decision.reason.endswith("MOVING") for decision in record.decisions)
    applied = record.told[record.stamps <= record.stamps[-1] - 20 * MS].max()
    assert record.shares.max() <= applied + 1e-12
