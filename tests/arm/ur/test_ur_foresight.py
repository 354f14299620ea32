"""The program's own velocity behind a slider: remembered while the arm is held back, and never for longer than that."""

from __future__ import annotations

import numpy as np
import pytest
from fake_link import MODEL, sample

from twin_node.arm.ur import Foresight
from twin_node.arm.ur.sample import RuntimeState
from twin_node.scene import Float64

PACKAGE_NS = 8_000_000
FIRST = np.array([0.5, 0, 0, 0, 0, 0])
SECOND = np.array([0, -0.4, 0, 0, 0, 0])


class Program:
    """A program and its slider, which the arm obeys within a package."""

    def __init__(self) -> None:
        self.foresight = Foresight(MODEL)
        self.now = 1_000_000_000

    def run(self, shares: list[float], velocity: Float64) -> Float64:
        """A package per share, the program meaning to move so; gives back what is foreseen at last, rad/s."""
        for share in shares:
            self.now += PACKAGE_NS
            ahead = self.foresight.ahead(sample(speed_slider=share, target_qd=share * velocity), self.now, self.now)
        foreseen: Float64 = (ahead.positions[-1] - ahead.positions[0]) / 0.2
        return foreseen


def test_a_speed_that_is_corrected_all_the_time_hides_no_turn_of_the_program() -> None:
    """The law gives another share with every decision: each fall was taken for braking, which lasts 200 ms."""
    program = Program()
    program.run([1.0] * 50, FIRST)
    np.testing.assert_allclose(program.run([0.52, 0.51, 0.50] * 100, SECOND), SECOND, atol=1e-9)


@pytest.mark.parametrize("share", [0.01, 0.04])
def test_an_arm_that_creeps_is_foreseen_where_it_creeps_to(share: float) -> None:
    program = Program()
    program.run([1.0] * 50, FIRST)
    np.testing.assert_allclose(program.run([share] * 100, SECOND), SECOND, atol=1e-9)


def test_a_program_that_begins_at_a_crawl_is_foreseen_at_its_full_speed() -> None:
    np.testing.assert_allclose(Program().run([0.03] * 10, FIRST), FIRST, atol=1e-9)


def test_an_arm_that_lags_behind_a_slider_that_rises_keeps_what_is_known_of_its_program() -> None:
    program = Program()
    program.run([1.0] * 50, FIRST)
    program.run([0.0] * 50, FIRST)
    now = program.now + PACKAGE_NS
    lagging = program.foresight.ahead(sample(speed_slider=0.04, target_qd=0.004 * FIRST), now, now)
    np.testing.assert_allclose((lagging.positions[-1] - lagging.positions[0]) / 0.2, FIRST, atol=1e-9)


def test_braking_is_not_taken_for_a_faster_program() -> None:
    program = Program()
    program.run([1.0] * 50, FIRST)
    now = program.now + PACKAGE_NS
    still_fast = program.foresight.ahead(sample(speed_slider=0.2, target_qd=FIRST), now, now)
    np.testing.assert_allclose((still_fast.positions[-1] - still_fast.positions[0]) / 0.2, FIRST, atol=1e-9)


@pytest.mark.parametrize("state", [RuntimeState.PAUSING, RuntimeState.PAUSED, RuntimeState.RESUMING])
def test_a_program_that_is_paused_still_means_to_go_on(state: RuntimeState) -> None:
    """It seemed to close in on nobody: beside whoever pressed play the slider was at full speed."""
    program = Program()
    program.run([1.0] * 50, FIRST)
    for share in (1.0, 0.0, 1.0):
        now = program.now = program.now + 500_000_000
        paused = sample(runtime_state=state, speed_slider=share, target_qd=np.zeros(6))
        ahead = program.foresight.ahead(paused, now, now)
        np.testing.assert_allclose((ahead.positions[-1] - ahead.positions[0]) / 0.2, FIRST, atol=1e-9)
    np.testing.assert_allclose(program.run([1.0] * 30, SECOND), SECOND, atol=1e-9)


@pytest.mark.parametrize("state", [RuntimeState.STOPPING, RuntimeState.STOPPED])
def test_a_program_that_has_ended_means_nothing_any_more(state: RuntimeState) -> None:
    program = Program()
    program.run([1.0] * 50, FIRST)
    assert program.foresight.is_known
    for told in (state, RuntimeState.PAUSED):  # another is loaded, which nobody has seen run
        now = program.now = program.now + PACKAGE_NS
        ahead = program.foresight.ahead(sample(runtime_state=told, target_qd=np.zeros(6)), now, now)
        np.testing.assert_allclose(ahead.positions[-1], ahead.positions[0])
        assert not program.foresight.is_known


def test_a_scaling_beyond_one_makes_no_program_slower_than_it_is() -> None:
    ahead = Foresight(MODEL).ahead(sample(speed_slider=0.5, speed_scaling=100.0, target_qd=0.5 * FIRST), 1, 1)
    np.testing.assert_allclose((ahead.positions[-1] - ahead.positions[0]) / 0.2, FIRST, atol=1e-9)


def test_an_arm_that_was_heard_of_a_while_ago_has_gone_on_as_it_was_told() -> None:
    """At 3 rad/s it is 15 cm from where it was, a metre away, before its driver calls the controller silent."""
    program = Program()
    program.run([1.0] * 50, FIRST)
    state = sample(speed_slider=0.5, target_qd=0.5 * FIRST)
    ahead = program.foresight.ahead(state, program.now, program.now + 48_000_000)
    assert ahead.stamps[0] == program.now + 48_000_000
    np.testing.assert_allclose(ahead.positions[0] - state.target_q, 0.5 * FIRST * 0.048, atol=1e-12)
    np.testing.assert_allclose((ahead.positions[-1] - ahead.positions[0]) / 0.2, FIRST, atol=1e-9)
