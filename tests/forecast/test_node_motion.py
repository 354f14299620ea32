"""Poses are forecast with their turns, by experts that are weighed by what came true."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin_node.forecast.node_motion import NodeMotion
from twin_node.geometry import quat_from_rotation
from twin_node.scene import Float64, NodeStates

DT_NS = 33_000_000
AHEAD_S = 0.2


def about_z(angle: float) -> Float64:
    """[3, 3]."""
    return np.array([[np.cos(angle), -np.sin(angle), 0], [np.sin(angle), np.cos(angle), 0], [0, 0, 1.0]])


def node(place: Float64, R: Float64, name: int = 4) -> NodeStates:
    """One node."""
    zero = np.zeros((1, 3))
    quat = quat_from_rotation(R[None])
    return NodeStates(np.array([name], np.uint32), place[None], quat, zero, zero, np.full(1, 0.01), np.full(1, 0.1))


@given(st.floats(-0.5, 0.5), st.floats(-1.2, 1.2))
def test_a_steady_motion_is_carried_on_turn_and_all(speed: float, turn: float) -> None:
    motion = NodeMotion()
    for index in range(25):
        t = index * DT_NS * 1e-9
        motion.advance(index * DT_NS, node(np.array([speed * t, 0, 0.3]), about_z(turn * t)), AHEAD_S)
    moves = motion.ahead_by("constant_velocity", AHEAD_S)
    assert moves.R[0] == pytest.approx(about_z(turn * AHEAD_S), abs=0.02)
    assert moves.shifts[0] == pytest.approx([speed * AHEAD_S, 0, 0], abs=1e-3)
    corner = motion.ahead(AHEAD_S).moved(np.array([[speed * t + 0.1, 0, 0.3]]), 0)[0]
    assert corner[0] == pytest.approx(speed * t + speed * AHEAD_S + 0.1 * np.cos(turn * AHEAD_S), abs=0.035)


def test_what_rests_stays_and_rotations_stay_rotations() -> None:
    motion, rng = NodeMotion(), np.random.default_rng(1)
    for index in range(20):
        motion.advance(
            index * DT_NS, node(np.array([0.1, 0.2, 0.3]) + 1e-4 * rng.standard_normal(3), np.eye(3)), AHEAD_S
        )
    moves = motion.ahead(AHEAD_S)
    assert np.linalg.norm(moves.shifts[0]) < 0.002
    assert np.linalg.det(moves.R[0]) == pytest.approx(1.0)


def test_a_new_node_and_none_at_all_are_forecast_too() -> None:
    motion = NodeMotion()
    for index in range(6):
        motion.advance(index * DT_NS, node(np.zeros(3), np.eye(3), name=index // 3), AHEAD_S)
    assert motion.ahead(AHEAD_S).shifts == pytest.approx(np.zeros((1, 3)), abs=1e-9)
    motion.advance(6 * DT_NS, NodeStates.none(), AHEAD_S)
    assert motion.ahead(AHEAD_S).shifts.shape == (0, 3)
