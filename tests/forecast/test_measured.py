"""Measured velocities: how far nodes get of which there is no record yet, and who counts as one."""

from __future__ import annotations

from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from twin_node.bag.trajectory_files import read_trajectories
from twin_node.forecast.bound import PERSON_SPEED
from twin_node.forecast.measured import UNKNOWN_SPEED, Measured, most_astray, start_radii
from twin_node.scene import Bool, Float64

HORIZON = 0.2
REACHABLE = 0.12
RESTING_SPEED = 0.15
"""What is slower rests, m/s."""


def of(sigma: float, flying: bool = False, alone: bool = False, falling: bool = False) -> Measured:
    return both(np.array([sigma]), np.array([flying]), np.array([alone]), np.array([falling]))


def both(sigmas: Float64, flying: Bool, alone: Bool, falling: Bool | None = None) -> Measured:
    falling = np.zeros(len(sigmas), np.bool_) if falling is None else falling
    return Measured(sigmas, flying, alone, falling, np.full(len(sigmas), -np.inf), np.zeros(len(sigmas)))


def reach(measured: Measured, spread: float = 0.0, speed: float = 0.0) -> float:
    return float(measured.reach(np.array([spread]), np.array([speed]), REACHABLE, HORIZON)[0])


def newcomer(measured: Measured, known_s: float, age_s: float) -> bool:
    return bool(measured.newcomers(np.array([known_s]), np.array([age_s]), HORIZON)[0])


def test_what_nothing_is_known_of_may_go_as_fast_as_a_person_where_experts_agree() -> None:
    assert np.isclose(reach(of(UNKNOWN_SPEED)), REACHABLE + PERSON_SPEED * HORIZON)
    assert np.isclose(reach(of(0.9 * UNKNOWN_SPEED)), REACHABLE)


@given(sigma=st.floats(0, UNKNOWN_SPEED), spread=st.floats(0, 2), speed=st.floats(0, 10), flying=st.booleans())
def test_a_reach_is_never_less_than_acceleration_s_nor_more_than_a_fall_and_a_person_s(
    sigma: float, spread: float, speed: float, flying: bool
) -> None:
    radius = reach(of(sigma, flying), spread, speed)
    assert REACHABLE <= radius <= 9.82 * HORIZON**2 / 2 + PERSON_SPEED * HORIZON


def test_what_is_fast_and_not_known_to_fly_may_fall() -> None:
    fallen = 9.81 * HORIZON**2 / 2
    assert np.isclose(reach(of(0.0), speed=2.0), fallen)
    assert np.isclose(reach(of(0.0, flying=True), speed=2.0), REACHABLE)
    assert np.isclose(reach(of(0.0), speed=1.0), REACHABLE)
    assert np.isclose(reach(of(0.0), speed=PERSON_SPEED), REACHABLE)


def test_what_flies_is_as_uncertain_sooner() -> None:
    measured = both(np.zeros(2), np.array([False, True]), np.zeros(2, np.bool_))
    shares = measured.sooner(np.array([0.0, 0.25, 1.0]), np.array([0.0, 0.2, 1.0]))
    assert np.allclose(shares, [[0, 0], [0.2, 0.5], [1, 1]])


def test_newcomers_are_untried_or_fall() -> None:
    assert newcomer(of(0.1), known_s=0.1, age_s=0.1)
    assert not newcomer(of(0.1), known_s=0.3, age_s=0.1)
    assert not newcomer(of(0.1), known_s=0.1, age_s=0.3)  # foreseen, however it came
    assert not newcomer(of(0.1, flying=True), known_s=0.3, age_s=0.3)
    assert newcomer(of(0.1, flying=True, falling=True), known_s=0.5, age_s=0.5)


def test_limbs_may_start_at_any_time_and_what_is_seen_as_a_whole_does_not() -> None:
    together = both(np.zeros(2), np.zeros(2, np.bool_), np.array([False, True]))
    soon, late = together.start(np.array([0.03, HORIZON]))
    assert late[0] > soon[0] == 0
    assert late[1] == soon[1] == 0


@pytest.mark.parametrize("horizon_s", [0.133, 0.233, 0.333])
def test_people_at_rest_start_no_quicker(horizon_s: float, recordings: Path) -> None:
    """Real motion, from rest: trunk and head stay within the radius, hands and forearms as a rule (99 and 80 %)."""
    recorded = read_trajectories(recordings / "mocap" / "01_01.bvh")
    period_s = float(np.median(np.diff(recorded.times)))
    before, ahead = round(0.1 / period_s), round(horizon_s / period_s)
    here = recorded.positions[before:-ahead]
    resting = np.linalg.norm(here - recorded.positions[: -before - ahead], axis=-1) < 0.1 * RESTING_SPEED
    stayed = np.linalg.norm(recorded.positions[before + ahead :] - here, axis=-1) <= start_radii(np.array([horizon_s]))
    for names, least in ((("Head", "Neck", "Spine", "Hips", "LeftArm", "RightArm"), 0.99), (("Hand", "ForeArm"), 0.8)):
        columns = [row for row, name in enumerate(recorded.names) if any(one in name for one in names)]
        assert stayed[:, columns][resting[:, columns]].mean() >= least


class Astray(NamedTuple):
    """How far parts of people got from where they went straight on."""

    speeds: Float64
    """[n] m/s, they went at."""
    shares: Float64
    """[n] of `most_astray`."""

    @classmethod
    def of(cls, recordings: Path, horizon_s: float) -> Astray:
        """Real motion of hands, arms, trunk and head."""
        recorded = read_trajectories(recordings / "mocap" / "01_01.bvh")
        names = ("Hand", "Arm", "Head", "Neck", "Spine", "Hips")
        columns = [row for row, name in enumerate(recorded.names) if any(one in name for one in names)]
        positions, period_s = recorded.positions[:, columns], float(np.median(np.diff(recorded.times)))
        before, ahead = round(0.033 / period_s), round(horizon_s / period_s)
        velocities = (positions[before:] - positions[:-before])[:-ahead] / (before * period_s)
        astray = positions[before + ahead :] - positions[before:-ahead] - velocities * horizon_s
        speeds = np.linalg.norm(velocities, axis=-1).reshape(-1)
        return cls(speeds, np.linalg.norm(astray, axis=-1).reshape(-1) / most_astray(speeds, np.array([horizon_s]))[0])

    def at(self, slow: float, fast: float) -> Float64:
        """Shares of those at such speeds."""
        return self.shares[(self.speeds >= slow) & (self.speeds < fast)]


@pytest.mark.parametrize("horizon_s", [0.083, 0.133, 0.233, 0.3])
def test_people_get_no_farther_from_where_they_go_straight_on(horizon_s: float, recordings: Path) -> None:
    """Real motion: 99 % of hands, arms, trunk and head at any speed, and most of what is farther by little."""
    people = Astray.of(recordings, horizon_s)
    for slow, fast in ((0, 0.1), (0.1, 0.3), (0.3, 1.0), (1.0, 2.0), (2.0, np.inf), (2.7, np.inf)):
        chosen = people.at(slow, fast)
        assert np.mean(chosen <= 1) >= 0.985
        assert np.median(chosen) < 0.6


@pytest.mark.parametrize("horizon_s", [0.083, 0.133, 0.233, 0.3])
def test_no_much_narrower_bound_would_hold_people(horizon_s: float, recordings: Path) -> None:
    """Where they move three fifths of it do not hold 99 %, nor does a third where they are about to."""
    people = Astray.of(recordings, horizon_s)
    for slow, fast, share in ((0, 0.1, 0.35), (0.1, 0.3, 0.35), (0.3, 1.0, 0.6), (1.0, 2.0, 0.6), (2.7, np.inf, 0.6)):
        assert np.quantile(people.at(slow, fast), 0.99) > share


def test_a_bound_that_surprises_have_widened_is_no_wider_than_people_get_but_for_what_flies() -> None:
    known, flies, unknown = of(0.1), of(0.1, flying=True), of(UNKNOWN_SPEED)
    at_rest, horizons = np.zeros(1), np.array([0.0, 0.05, 0.2])
    most = known.most(at_rest, horizons)[:, 0]
    assert most[0] == 0
    assert most[2] - of(0.0).most(at_rest, horizons)[2, 0] == pytest.approx(0.1 / 2 * 0.2), "half a sigma's way"
    assert most[1] < 0.04 < most[2] < 0.2
    assert np.all(known.most(np.array([1.0]), horizons)[1:, 0] > most[1:])
    assert np.isinf(flies.most(at_rest, horizons)).all()
    assert np.isinf(unknown.most(at_rest, horizons)).all()


def test_what_rests_is_given_no_room_at_once_and_that_of_a_hand_by_the_last_horizon() -> None:
    none, hand = start_radii(np.array([0.04, HORIZON]))
    assert none == 0
    assert 0.13 < hand < 0.15


def test_what_flies_clear_of_everything_gets_no_farther_than_its_velocity_may_be_wrong() -> None:
    no = np.zeros(3, np.bool_)
    sigmas, clear_s = np.array([0.1, UNKNOWN_SPEED, 0.1]), np.array([0.15, 0.15, 0.0])
    told = Measured(sigmas, ~no, ~no, ~no, np.full(3, -np.inf), clear_s)
    horizons, reachable = np.array([0.05, 0.15, 0.2]), np.array([0.01, 0.07, REACHABLE])
    within = told.in_flight(horizons, reachable)
    assert np.allclose(within[0, :2], 0.02 + np.array([0.15, PERSON_SPEED]) * 0.05 + 0.01)
    assert np.isinf(within[1:]).all() and np.isinf(within[:, 2]).all()
