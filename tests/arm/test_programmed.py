"""The program's own velocity behind the share that an arm is held to, also where the clock is put back."""

from __future__ import annotations

import numpy as np
import pytest

from twin_node.arm.programmed import ProgrammedVelocity
from twin_node.scene import Float64

PACKAGE_NS = 8_000_000
NOW = 1_700_000_000_000_000_000
THERE = np.array([1.0, 0, 0, 0, 0, 0])
MINUTE_NS = 60_000_000_000


class Arm:
    """An arm that obeys its share within a package."""

    def __init__(self) -> None:
        self.programmed = ProgrammedVelocity(0.05, np.full(6, 3.14))
        self.now = NOW

    def run(self, packages: int, share: float, program: Float64) -> Float64:
        for _ in range(packages):
            self.now += PACKAGE_NS
            seen = self.programmed.seen(share * program, share, self.now)
        return seen


def test_the_share_is_taken_out_and_the_program_remembered_while_the_arm_stands() -> None:
    arm = Arm()
    np.testing.assert_allclose(arm.run(100, 0.5, THERE), THERE)
    np.testing.assert_allclose(arm.run(500, 0.0, THERE), THERE)


def test_what_is_braking_yet_is_not_taken_for_a_faster_program() -> None:
    arm = Arm()
    arm.run(100, 1.0, THERE)
    np.testing.assert_allclose(arm.programmed.seen(THERE, 0.2, arm.now + PACKAGE_NS), THERE)


def test_an_arm_that_brakes_for_a_second_still_means_to_go_on_as_fast() -> None:
    arm = Arm()
    arm.run(100, 1.0, THERE)
    for package in range(125):
        arm.now += PACKAGE_NS
        seen = arm.programmed.seen((1 - package / 150) * THERE, 0.0, arm.now)
    np.testing.assert_allclose(seen, THERE)


def test_a_program_that_turns_while_the_arm_is_slowed_more_and_more_is_known_to() -> None:
    """With every decision it would be braking anew, and be judged by where it went before."""
    arm = Arm()
    arm.run(100, 1.0, THERE)
    for share in np.linspace(0.9, 0.3, 40):
        seen = arm.run(2, float(share), -THERE)
    np.testing.assert_allclose(seen, -THERE)


def test_a_program_that_turns_at_a_crawl_is_known_to() -> None:
    arm = ProgrammedVelocity(0.005, np.full(6, 3.14))
    for package in range(100):
        seen = arm.seen(0.04 * (THERE if package < 50 else -THERE), 0.04, NOW + package * PACKAGE_NS)
    np.testing.assert_allclose(seen, -THERE)


@pytest.mark.parametrize("way", [THERE, -THERE])
def test_no_program_is_faster_than_the_arm_unless_the_arm_is(way: Float64) -> None:
    """Noise of an arm that hardly moves would count twenty times."""
    arm = Arm()
    np.testing.assert_allclose(arm.run(1, 0.1, 10 * way), 3.14 * way)
    np.testing.assert_allclose(arm.run(100, 1.0, 5 * way), 5 * way)


@pytest.mark.parametrize("way", [THERE, -THERE])
def test_an_arm_that_begins_more_slowly_than_tells_anything_later_means_to_go_at_full_speed(way: Float64) -> None:
    """Taken for led by hand, it would be let go as fast as its program means to, beside whoever it closes in on."""
    arm = Arm()
    np.testing.assert_allclose(arm.run(1, 0.02, 3 * way), 3 * way)
    noise = Arm()
    np.testing.assert_allclose(noise.run(50, 0.02, 0.5 * way), 0.01 * way)
    assert not noise.programmed.is_known
    led = Arm().programmed
    np.testing.assert_allclose(led.seen(0.3 * way, 0.0, NOW), 0.3 * way)


@pytest.mark.parametrize("way", [THERE, -THERE])
def test_a_program_that_slows_down_is_as_slow_but_an_arm_that_lags_at_a_crawl_is_not(way: Float64) -> None:
    arm = Arm()
    arm.run(100, 1.0, way)
    np.testing.assert_allclose(arm.run(100, 0.5, 0.2 * way), 0.2 * way)
    lagging = ProgrammedVelocity(0.005, np.full(6, 3.14))
    for package, (share, velocity) in enumerate([(1.0, 1.0), *[(0.0, 0.0)] * 50, (0.04, 0.004)]):
        seen = lagging.seen(velocity * way, share, NOW + package * PACKAGE_NS)
    np.testing.assert_allclose(seen, way)


@pytest.mark.parametrize(
    ("share", "ratio", "is_slow"), [(0.04, 0.4, False), (0.04, 0.6, True), (0.08, 0.4, True), (0.08, 0.1, True)]
)
def test_what_is_less_than_half_as_fast_at_a_crawl_may_merely_lag(share: float, ratio: float, is_slow: bool) -> None:
    arm = ProgrammedVelocity(0.005, np.full(6, 3.14))
    for package in range(100):
        arm.seen(THERE, 1.0, NOW + package * PACKAGE_NS)
    arm.seen(np.zeros(6), 0.0, NOW + 100 * PACKAGE_NS)
    seen = arm.seen(ratio * share * THERE, share, NOW + 200 * PACKAGE_NS)
    np.testing.assert_allclose(seen, (ratio if is_slow else 1.0) * THERE)


@pytest.mark.parametrize(("speed", "seconds", "is_led"), [(0.07, 1.6, True), (0.04, 1.6, False), (0.07, 1.4, False)])
def test_an_arm_that_still_moves_once_any_would_stand_is_led_by_hand(
    speed: float, seconds: float, is_led: bool
) -> None:
    arm = Arm()
    arm.run(100, 1.0, THERE)
    arm.run(1, 0.0, THERE)
    seen = arm.programmed.seen(-speed * THERE, 0.0, arm.now + round(seconds * 1e9))
    np.testing.assert_allclose(seen, -speed * THERE if is_led else THERE)


@pytest.mark.parametrize(("speed", "begins"), [(0.03, True), (0.015, False)])
def test_an_arm_of_which_nothing_is_known_begins_where_it_is_faster_than_noise(speed: float, begins: bool) -> None:
    programmed = Arm().programmed
    seen = programmed.seen(speed * THERE, 0.02, NOW)
    assert programmed.is_known == begins
    np.testing.assert_allclose(seen, (speed / 0.02 if begins else speed) * THERE)


@pytest.mark.parametrize("back_ns", [500_000_000, MINUTE_NS])
def test_a_clock_that_is_put_back_does_not_freeze_what_is_known_of_the_program(back_ns: int) -> None:
    """Until it had caught up an arm that went the other way was judged by where it had gone before."""
    arm = Arm()
    arm.run(100, 1.0, THERE)
    arm.run(50, 0.5, THERE)
    arm.run(100, 1.0, THERE)
    arm.now -= back_ns
    np.testing.assert_allclose(arm.run(1, 1.0, -THERE), -THERE)
    np.testing.assert_allclose(arm.run(100, 0.5, -THERE), -THERE)


def test_an_arm_that_stands_when_its_clock_is_put_back_still_means_to_go_on() -> None:
    arm = Arm()
    arm.run(100, 1.0, THERE)
    arm.run(100, 0.0, THERE)
    arm.now -= MINUTE_NS
    np.testing.assert_allclose(arm.run(500, 0.0, THERE), THERE)
    arm.run(250, 0.0, THERE)
    led = arm.programmed.seen(-0.3 * THERE, 0.0, arm.now + PACKAGE_NS)  # by hand: it obeys nobody
    np.testing.assert_allclose(led, -0.3 * THERE)
