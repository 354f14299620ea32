"""An arm that obeys its node: of which only joints come, and that is led by hand."""

from __future__ import annotations

import numpy as np
import pytest
from arm_cell import MODEL, READY, TURNING, Cell, Timers

from twin_node.arm import stopping_table
from twin_node.arm.narrow import sphere_distances
from twin_node.robot import forward_kinematics, place_capsules
from twin_node.scene import Float64, ObstacleKind


def obeying(cell: Cell, q: Float64, periods: int) -> Float64:
    """Joints at 125 Hz from `q` on, forecasts every 32 ms of somebody in the arm's way; gives back its last joints."""
    at = forward_kinematics(MODEL, READY + 1.5 * TURNING)[-1, :3, 3]
    for i in range(periods):
        cell.wait(8)
        share = cell.told[-1].speed_fraction if cell.told else 0.0
        q = q + TURNING * share * 0.008
        cell.joints(q, TURNING * share)
        if i % 4 == 0:
            cell.somebody(at=at)
    return q


def test_an_arm_of_which_only_joints_are_known_does_not_creep_up_to_who_stands_in_its_way() -> None:
    """Stopped, it seemed to close in on nobody, and was told to go on until it moved: 4 % of its speed every 66 ms."""
    cell = Cell(Timers())
    stopped = obeying(cell, READY, 300)
    assert cell.told[-1].reason == "stopped for MOVING"
    np.testing.assert_array_equal(obeying(cell, stopped, 300), stopped)


def test_nor_does_one_that_was_stopped_before_its_node_began() -> None:
    """It was never seen at a twentieth of its speed, from which on its program was learnt: it crept up to 4 cm."""
    cell, at = Cell(Timers()), forward_kinematics(MODEL, READY + 0.4 * TURNING)[-1, :3, 3]
    q, share = READY, 0.0
    for i in range(300):
        cell.wait(8)
        q = q + TURNING * share * 0.008
        cell.joints(q, TURNING * share)
        if i % 4 == 0:
            share = cell.somebody(at=at).speed_fraction
    assert cell.told[-1].reason == "stopped for MOVING"
    assert np.abs(q - READY).max() < 0.005


def test_an_arm_that_is_led_by_hand_or_obeys_nobody_is_judged_as_it_moves() -> None:
    cell = Cell(Timers(), slide_s=0.0)  # nor does it follow a slider
    stopped = obeying(cell, READY, 400)
    at = forward_kinematics(MODEL, READY + 1.5 * TURNING)[-1, :3, 3]
    for _ in range(30):
        cell.wait(8)
        cell.joints(stopped, -0.3 * TURNING)
    assert cell.somebody(at=at).reason == "clear of MOVING; speeding up"


def test_an_arm_that_is_held_back_is_judged_where_it_is_and_not_where_it_would_be_when_a_forecast_begins() -> None:
    """It was taken to be there, at its full speed, beyond somebody whom it still closed in on: it went on into them."""
    cell, at = Cell(Timers()), forward_kinematics(MODEL, READY + 0.35 * TURNING)[-1, :3, 3]
    for _ in range(40):
        cell.wait(20)
        cell.path(begins_ms=0, lasts_ms=200, velocity=2 * TURNING)
        cell.joints(qd=np.zeros(6))
        told = cell.somebody(at=at, begins_ms=300)
    assert (told.reason, told.speed_fraction) == ("stopped for MOVING", 0)


def test_nor_where_old_joints_would_have_gone_by_its_program() -> None:
    cell = Cell(Timers())
    stopped = obeying(cell, READY, 300)
    cell.joints(stopped, np.zeros(6), ago_ms=-1)
    cell.wait(350)
    at = forward_kinematics(MODEL, stopped + 0.1 * TURNING)[-1, :3, 3]
    cell.somebody(at=at)
    told = cell.somebody(at=at)
    assert (told.reason, told.speed_fraction) == ("stopped for MOVING", 0)


@pytest.mark.parametrize(("servoed", "turning"), [(False, 0.5), (True, 0.2)])
def test_an_arm_that_follows_a_slider_takes_as_long_to_stop_from_a_slow_part_of_its_program(
    servoed: bool, turning: float
) -> None:
    """Its program began to move: by the stopping table it would have stood in 0.02 s, and it took 0.15 s."""

    def told(slide_s: float) -> float:
        cell = Cell(Timers(), slide_s=slide_s, servoed=servoed, limiter={"rise_per_s": 100.0})
        for _ in range(30):
            cell.wait(33)
            cell.path(begins_ms=0, lasts_ms=200, velocity=turning * TURNING)
            cell.joints(qd=turning * TURNING)
            cell.somebody()
        return cell.told[-1].speed_fraction

    assert 0.5 < told(0.2) < 1
    assert (told(0.2) < told(0.0)) is not servoed


@pytest.mark.parametrize("tells_path", [True, False])
def test_an_arm_that_hears_late_of_its_commands_stops_as_far_from_what_stands(tells_path: bool) -> None:
    """It was taken to brake at once, and of rising speed to do what it had not heard of yet: it went on into a ball."""
    cell = Cell(Timers(), command_latency_ms=150)
    table, fast = stopping_table("ur5e"), 2 * TURNING
    at = forward_kinematics(MODEL, READY + 1.5 * TURNING)[-1, :3, 3]
    q, share, commands, nearest = READY, 0.0, [0.0] * 18, np.inf
    for i in range(250):
        cell.wait(8)
        if tells_path:
            cell.path(begins_ms=0, lasts_ms=200, velocity=fast, start=q)
        cell.joints(q, fast * share)
        if i % 4 == 0:
            cell.somebody(at=at, kind=ObstacleKind.STATIC)
        commands.append(cell.told[-1].speed_fraction)
        slower = share - 0.008 * share / max(2 * table.stop(share * fast).travel_s, 1e-6)
        share = max(commands[-19], slower)
        q = q + fast * share * 0.008
        if share > 0.01:
            nearest = min(nearest, clearance(q, at))
    assert 0.03 < nearest < 0.05


def clearance(q: Float64, at: Float64) -> float:
    """Of the arm from a ball of 10 cm, m."""
    placed = place_capsules(MODEL, forward_kinematics(MODEL, q))
    count = len(placed.radii)
    return float(sphere_distances(placed.ends, placed.radii, np.tile(at, (count, 1)), np.full(count, 0.05)).min())
