"""The slider's echo and its idleness, step by step."""

from __future__ import annotations

from dataclasses import replace

import pytest
from driver_bench import MS, STEP_MS
from fake_link import FakeLink

from twin_node.arm.ur.slider import Slider


@pytest.mark.parametrize("late_ms", [20, 80])
def test_a_slider_that_is_lowered_for_long_may_show_late_what_it_was_set_to(late_ms: int) -> None:
    """It reads more than it was set to all the while, and never more than it had been within the time of its echo."""
    link = FakeLink()
    slider = Slider(link)
    for now_ms in range(4, 900, STEP_MS):
        told, shown = (1 - max(ms, 0) / 1000 for ms in (now_ms, now_ms - late_ms))
        slider.move(told, now_ms * MS)
        assert slider.disobedience(replace(link.state, speed_slider=shown), now_ms * MS) is None


def test_a_slider_that_comes_up_late_is_not_said_to_be_held_before_a_second_has_passed() -> None:
    link = FakeLink()
    slider = Slider(link)
    said = []
    for now_ms in range(4, 1400, STEP_MS):
        slider.move(0.8, now_ms * MS)
        said.append(slider.idleness(replace(link.state, speed_slider=0.1, runtime_state=2), now_ms * MS))
    told = 1000 // STEP_MS + 1
    assert set(said[:told]) == {""}
    assert set(said[told:]) == {"; but the speed slider stays at 10%"}
