"""What is seen to move against the forecast made for it: by points where depth is measured, else by pixels."""

from __future__ import annotations

import numpy as np
import pytest
from forecast_worlds import GRID, ball_voxels, state_of

from twin_node.forecast.judgement import Judgement
from twin_node.forecast.margin import Margin
from twin_node.forecast.tables import RigTables

CENTER = np.array([0.1, 0.0, 0.4])


@pytest.mark.parametrize("depth", [True, False])
def test_what_is_seen_is_held_by_a_forecast_as_far_as_that_reaches(depth: bool) -> None:
    margin = Margin(GRID, 0.15)
    tables, state = RigTables(margin.outer), state_of(0, CENTER, with_depth=depth)
    ball = ball_voxels(CENTER, 0.16)
    half = ball[GRID.centers(ball)[:, 2] > CENTER[2]]
    whole, some, none = (
        Judgement(state, margin, tables, forecast).of(margin.outward(ball)) for forecast in (ball, half, ball[:0])
    )
    assert whole.seen == some.seen == none.seen > 100
    assert whole.covered == whole.seen and none.covered == 0
    assert 0.2 * whole.seen < some.covered < 0.95 * whole.seen
    assert whole.measured == (whole.seen if depth else 0)


def test_points_that_no_other_camera_confirms_are_not_asked_for() -> None:
    margin = Margin(GRID, 0.15)
    ball = ball_voxels(CENTER, 0.16)
    judgement = Judgement(state_of(0, CENTER, with_depth=True), margin, RigTables(margin.outer), ball)
    part = margin.outward(ball[GRID.centers(ball)[:, 0] > CENTER[0]])
    held, nothing = judgement.of(part), judgement.of(part[:0])
    assert 0 < held.agreed < held.measured and held.seen == held.covered == held.agreed
    assert nothing.seen == nothing.covered == nothing.agreed == 0
