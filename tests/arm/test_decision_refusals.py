"""The separation law: what it refuses, and lets nothing move for."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from obstacle_sets import MS, NOW, obstacles
from turning_arm import REACTION_S, TURNING, ahead, beside_the_tool

from twin_node.arm import (
    Approaches,
    ArmCollisionChecker,
    ArmError,
    SeparationParameters,
    decide,
    stopping_table,
)
from twin_node.arm.course import ArmMotion
from twin_node.arm.separation import Encounter, hazards
from twin_node.scene import NO_EVIDENCE, JointPath

GOOD = ahead(TURNING)


def test_a_law_that_nothing_is_fast_enough_for_is_refused() -> None:
    """10, millimetres by what was meant, let an arm close in on anybody at less than 10 m/s."""
    with pytest.raises(ArmError, match=r"separation: closing_speed: expected 0 to 0\.25, found 10"):
        SeparationParameters(closing_speed=10.0)


@pytest.mark.parametrize("name", ["human_speed", "intrusion_m", "clearance_m", "position_error_m", "closing_speed"])
@pytest.mark.parametrize("value", [-0.1, np.nan, np.inf])
def test_constants_that_no_law_has_are_refused(name: str, value: float) -> None:
    expected = "0 to 0.25" if name == "closing_speed" else "a number of 0 or more"
    with pytest.raises(ArmError, match=f"{name}: expected {expected}, found {value:g}"):
        SeparationParameters(**{name: value})


@pytest.mark.parametrize(
    ("path", "reaction_s", "word"),
    [
        (replace(GOOD, stamps=GOOD.stamps[::-1]), REACTION_S, "expected strictly increasing stamps"),
        (replace(GOOD, stamps=np.full(21, NOW)), REACTION_S, "expected strictly increasing stamps"),
        (replace(GOOD, stamps=np.append(GOOD.stamps[:20], GOOD.stamps[19])), REACTION_S, "strictly increasing stamps"),
        (replace(GOOD, positions=GOOD.positions[:5]), REACTION_S, "one angle per stamp and joint, found "),
        (replace(GOOD, stamps=GOOD.stamps[:0], positions=GOOD.positions[:0]), REACTION_S, "found no sample"),
        (replace(GOOD, stamps=GOOD.stamps + 40 * MS), REACTION_S, "found one that begins 40 ms later"),
        (replace(GOOD, stamps=GOOD.stamps - 40 * MS), REACTION_S, "found one that begins -40 ms later"),
        (GOOD, -1.0, "reaction_s: expected 0 or more seconds, found -1"),
        (GOOD, np.nan, "reaction_s: expected 0 or more seconds, found nan"),
        (GOOD, np.inf, "reaction_s: expected 0 or more seconds, found inf"),
    ],
)
def test_paths_and_reactions_that_cannot_be_are_refused_not_called_clear(
    ur5e_checker: ArmCollisionChecker, path: JointPath, reaction_s: float, word: str
) -> None:
    ur5e_checker.update(obstacles(beside_the_tool(ur5e_checker, 0.25)))
    with pytest.raises(ArmError, match=word):
        decide(ur5e_checker, path, NOW, reaction_s)


def test_a_law_that_gives_no_number_lets_nothing_move(ur5e_checker: ArmCollisionChecker) -> None:
    """Of a velocity whose square is infinite it said "clear"."""
    infinite = SeparationParameters(intrusion_m=1e308, position_error_m=1.7e308)
    ur5e_checker.update(obstacles(beside_the_tool(ur5e_checker, 0.25)))
    with np.errstate(over="ignore"), pytest.raises(ArmError, match="protective distance from obstacle 100, found inf"):
        decide(ur5e_checker, ahead(TURNING), NOW, REACTION_S, infinite)
    motion = ArmMotion(NOW, REACTION_S, TURNING, stopping_table("ur5e"))
    found = hazards(ur5e_checker.obstacles, NOW, SeparationParameters())
    row = np.zeros(1, np.int64)
    pair = Approaches(row, row, np.full((1, 1), np.nan))
    unknown = Encounter.of(found, pair, np.ones(1), motion, SeparationParameters())
    with np.errstate(invalid="ignore"):
        assert np.isnan(unknown.shortfall(1.0)).all()
        assert unknown.largest_share() == 0.0


def test_without_any_forecast_the_arm_stands() -> None:
    found = decide(ArmCollisionChecker("ur5e"), ahead(TURNING), NOW, REACTION_S)
    assert (found.speed_fraction, found.evidence_stamp) == (0.0, NO_EVIDENCE)


def test_a_time_of_another_clock_is_refused(ur5e_checker: ArmCollisionChecker) -> None:
    ur5e_checker.update(obstacles(beside_the_tool(ur5e_checker, 0.1)))
    up_s = 3600 * 10**9  # such as time.monotonic_ns() gives
    with pytest.raises(ArmError, match="clock of the obstacles' stamps"):
        decide(ur5e_checker, ahead(TURNING, up_s), up_s, REACTION_S)
    assert decide(ur5e_checker, ahead(TURNING, NOW - 199 * MS), NOW - 199 * MS, REACTION_S).evidence_stamp == NOW
    with pytest.raises(ArmError, match=r"found one 0\.201 s before"):
        decide(ur5e_checker, ahead(TURNING, NOW - 201 * MS), NOW - 201 * MS, REACTION_S)
