"""A set that would be out late takes fewer steps, if that helps and not too often."""

from __future__ import annotations

import itertools
import math

import numpy as np
import pytest
from model_scenes import rig, sliding

from twin_node.model import ModelParameters, SeedParameters, WindowModel
from twin_node.model.step_budget import IN_A_ROW, SPARED, Part, StepBudget

STEP_S, ENDING_S = 0.002, 0.001


class Watch:
    """A clock that stands but for what a test says has been done."""

    def __init__(self) -> None:
        self.now_s = 0.0

    def counting_from(self, left_s: float) -> object:
        due = self.now_s + left_s
        return lambda: due - self.now_s


def fitted(budget: StepBudget, watch: Watch, left_s: float, catches_up: bool = False) -> tuple[int, ...]:
    """The steps that a set is granted which has `left_s` when its first part begins."""
    budget.begin(watch.counting_from(left_s))
    granted = []
    for part in (Part.CATCH_UP, Part.FIT) if catches_up else (Part.FIT,):
        steps = budget.steps(part)
        watch.now_s += steps * STEP_S
        budget.done(part, steps)
        granted.append(steps)
    watch.now_s += ENDING_S
    budget.end()
    return tuple(granted)


def practised(ease: int = 8, catch_ups: int = 2) -> tuple[StepBudget, Watch]:
    """One that has seen sets with time for all of three steps."""
    budget, watch = StepBudget({Part.CATCH_UP: catch_ups, Part.FIT: 3}), Watch()
    for _ in range(ease):
        assert fitted(budget, watch, 1.0, catches_up=True) == (catch_ups, 3)
    return budget, watch


@pytest.mark.parametrize(("left_s", "expected"), [(0.0075, 3), (0.0055, 2), (0.0035, 1), (0.001, 1), (-0.0025, 1)])
def test_steps_are_those_that_there_is_time_for(left_s: float, expected: int) -> None:
    budget, watch = practised()
    assert fitted(budget, watch, left_s) == (expected,)
    assert budget.hurried == (expected < 3)


def test_nothing_is_spared_on_a_set_that_is_past_saving() -> None:
    budget, watch = practised()
    assert fitted(budget, watch, -0.0035) == (3,)
    assert budget.hurried == 0


@pytest.mark.parametrize(("left_s", "expected"), [(0.0115, (2, 3)), (0.0095, (2, 2)), (0.0055, (1, 1))])
def test_catching_up_leaves_time_for_a_step_of_what_follows(left_s: float, expected: tuple[int, ...]) -> None:
    budget, watch = practised()
    assert fitted(budget, watch, left_s, catches_up=True) == expected
    assert budget.hurried == (expected != (2, 3))


def test_where_every_set_is_late_none_is_hurried_for_long() -> None:
    budget, watch = practised()
    granted = [fitted(budget, watch, 0.002)[0] for _ in range(50)]
    assert granted[:IN_A_ROW] == [1] * IN_A_ROW
    assert granted[IN_A_ROW:] == [3] * (50 - IN_A_ROW)
    assert budget.hurried == IN_A_ROW


def test_one_in_so_many_may_be_hurried_where_that_brings_it_in_time() -> None:
    budget, watch = practised()
    granted = [fitted(budget, watch, 0.0035 if index % 20 == 0 else 1.0)[0] for index in range(400)]
    assert granted[::20] == [1] * 20
    assert budget.hurried == 20


def test_late_sets_leave_fewer_to_be_hurried() -> None:
    """Past saving for a while, and then in time again: it takes ten such sets for one that may be hurried."""
    budget, watch = practised()
    for _ in range(IN_A_ROW):
        assert fitted(budget, watch, -1.0) == (3,)
    for _ in range(round(1 / SPARED) - 1):
        assert fitted(budget, watch, 1.0) == (3,)
    assert fitted(budget, watch, 0.0035) == (3,)
    for _ in range(2 * round(1 / SPARED)):
        assert fitted(budget, watch, 1.0) == (3,)
    assert fitted(budget, watch, 0.0035) == (1,)


def test_nobody_is_hurried_before_a_step_was_timed() -> None:
    budget, watch = StepBudget({Part.CATCH_UP: 2, Part.FIT: 3}), Watch()
    assert fitted(budget, watch, 0.0001, catches_up=True) == (2, 3)


def test_one_pause_of_the_machine_changes_nothing() -> None:
    budget, watch = practised()
    budget.begin(watch.counting_from(1.0))
    steps = budget.steps(Part.FIT)
    watch.now_s += 0.5
    budget.done(Part.FIT, steps)
    budget.end()
    assert fitted(budget, watch, 0.0075) == (3,)


def test_no_time_is_read_where_nobody_waits() -> None:
    budget = StepBudget({Part.CATCH_UP: 2, Part.FIT: 3})
    for _ in range(20):
        budget.begin(lambda: math.inf)
        assert not budget.may_be_late
        assert (budget.steps(Part.CATCH_UP), budget.steps(Part.FIT)) == (2, 3)
        budget.done(Part.FIT, 3)
        budget.end()
    assert budget.hurried == 0


def test_a_model_that_is_late_goes_on_following() -> None:
    """Every look at the clock finds it a bit on, so that sets have time for one step of three."""
    images = []
    for left_s in (math.inf, 0.0003):
        model = WindowModel(ModelParameters(seed=SeedParameters(steps=20)))
        for one in sliding(30, rig()):
            ticks = itertools.count(1)
            model.update(one, lambda ticks=ticks, left_s=left_s: left_s - 0.0001 * next(ticks))
        images.append(model.render(rig()[0]).rgb)
    assert model.hurried
    assert 0 < np.abs(images[0] - images[1]).mean() < 0.02
