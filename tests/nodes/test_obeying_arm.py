"""An arm that obeys its node: of which only joints come, and that is led by hand."""

from __future__ import annotations

import numpy as np
from arm_cell import MODEL, READY, TURNING, Cell, Timers

from twin_node.robot import forward_kinematics
from twin_node.scene import Float64


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
    cell = Cell(Timers())
    stopped = obeying(cell, READY, 400)
    at = forward_kinematics(MODEL, READY + 1.5 * TURNING)[-1, :3, 3]
    for _ in range(30):
        cell.wait(8)
        cell.joints(stopped, -0.3 * TURNING)
    assert cell.somebody(at=at).reason in ("clear", "not closing in")


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
