from __future__ import annotations

import numpy as np
import pytest

from twin_node.cell import CellError
from twin_node.cell.actors import Person
from twin_node.cell.motion import GRAVITY, Path
from twin_node.cell.people import FOREARM, HAND, UPPER_ARM, bent_arm
from twin_node.geometry import pose

TWO = ((0.0, 0.0, 0.5), (1.0, 0.4, 0.7))


def speed(path: Path, t: float) -> np.ndarray:
    return (path.position(t + 1e-5) - path.position(t - 1e-5)) / 2e-5


@pytest.mark.parametrize("between", ["linear", "minimum_jerk", "ballistic", "spline"])
def test_every_path_goes_through_its_waypoints_and_rests_outside(between: str) -> None:
    path = Path((1.0, 2.0, 4.0), (*TWO, (0.3, 0.3, 0.3)), between=between)
    for t, expected in zip(
        (0.0, 1.0, 2.0, 4.0, 9.0), (TWO[0], *TWO, path.positions[2], path.positions[2]), strict=True
    ):
        assert np.allclose(path.position(t), expected)


def test_a_reach_starts_and_ends_at_rest_and_peaks_in_the_middle() -> None:
    path = Path((0.0, 1.0), TWO)
    assert np.linalg.norm(speed(path, 0.001)) < 0.01
    assert np.linalg.norm(speed(path, 0.999)) < 0.01
    distance = np.linalg.norm(np.subtract(*TWO))
    assert np.linalg.norm(speed(path, 0.5)) == pytest.approx(1.875 * distance, rel=1e-3)


def test_flight_falls_with_gravity() -> None:
    path = Path((0.0, 0.8), TWO, between="ballistic")
    acceleration = (path.position(0.41) - 2 * path.position(0.4) + path.position(0.39)) / 1e-4
    assert np.allclose(acceleration, [0, 0, -GRAVITY], atol=1e-6)


@pytest.mark.parametrize(("between", "moves"), [("ballistic", True), ("linear", False), ("spline", False)])
def test_what_is_thrown_straight_up_moves(between: str, moves: bool) -> None:
    """As furniture it would have stood where it was thrown from."""
    path = Path((0.0, 0.4), (TWO[0], TWO[0]), between=between)
    assert path.moves == moves == bool(path.position(0.2)[2] > TWO[0][2] + 0.1)


def test_a_repeated_path_starts_again() -> None:
    path = Path((0.0, 1.0, 2.0), (*TWO, TWO[0]), repeat=True)
    assert np.allclose(path.position(7.3), path.position(1.3))


def test_turns_add_up_beyond_a_full_circle() -> None:
    path = Path((0.0, 1.0), TWO, ((0, 0, 0), (0, 0, 720)), between="linear")
    assert np.allclose(path.pose(0.125)[:3, :3] @ [1, 0, 0], [0, 1, 0])
    assert np.allclose(path.pose(0.5)[:3, :3], np.eye(3))


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (((1.0, 1.0), TWO), "rising"),
        (((), ()), "one or more"),
        (((0.0, 1.0, 2.0), TWO), "3 positions"),
        (((0.0, 1.0), TWO, ((0.0, 0.0, 0.0),)), "found 2 and 1"),
        (((0.0, 1.0), TWO, (), "bezier"), "'bezier'"),
    ],
)
def test_wrong_paths_are_refused(arguments: tuple[object, ...], words: str) -> None:
    with pytest.raises(CellError, match=words):
        Path(*arguments)


@pytest.mark.parametrize("hand", [(0.4, 0.1, -0.2), (0.3, -0.4, 0.1), (2.0, 0.0, 0.0), (0.05, 0.0, 0.0)])
def test_the_arm_keeps_its_lengths_and_the_hand_its_direction(hand: tuple[float, float, float]) -> None:
    person = Person(height_m=1.8)
    shoulder = pose(np.eye(3), np.array([0.1, 0.2, 1.4]))
    wanted = shoulder[:3, 3] + hand
    elbow, wrist, palm = bent_arm(person, shoulder, wanted)
    assert np.linalg.norm(elbow - shoulder[:3, 3]) == pytest.approx(UPPER_ARM * 1.8)
    assert np.linalg.norm(wrist - elbow) == pytest.approx(FOREARM * 1.8)
    assert np.linalg.norm(palm - wrist) == pytest.approx(HAND * 1.8)
    towards = (palm - shoulder[:3, 3]) @ np.array(hand)
    assert towards == pytest.approx(np.linalg.norm(palm - shoulder[:3, 3]) * np.linalg.norm(hand))
    if 0.2 < np.linalg.norm(hand) < 0.6:
        assert np.allclose(palm, wanted)
