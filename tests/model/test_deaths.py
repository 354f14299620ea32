"""What depth says of single Gaussians: what is measured is needed, what is seen through is not."""

from __future__ import annotations

import numpy as np
import pytest
from model_scenes import table
from test_steps import balls, observe

from twin_node.model.deaths import SEEN_THROUGH, are_needed
from twin_node.model.observation import Observed
from twin_node.model.quality import MOVING_THRESHOLD
from twin_node.model.rays import back_project
from twin_node.scene import Bool, Float64


def on_what_moves(one: Observed, share: float) -> Float64:
    """[1, 3] m where a view sees what moves, at a share of its depth."""
    assert one.nearest is not None
    told: Bool = one.active & (one.surprise > MOVING_THRESHOLD) & (one.nearest > 0)
    places: Float64 = back_project(one.view.camera, share * one.nearest)[told]
    return places[len(places) // 2][None]


@pytest.mark.parametrize(
    ("first", "second", "needed"),
    [
        (1.0, 1.0, True),
        (1 + 0.8 * SEEN_THROUGH, 1.0, True),
        (1 - 0.8 * SEEN_THROUGH, 1.0, True),
        (1 + 1.2 * SEEN_THROUGH, 1 + 1.2 * SEEN_THROUGH, False),
        (1.0, 0.5, False),
        (0.5, 1.0, False),
    ],
)
def test_what_is_measured_is_needed_unless_another_view_sees_through_it(
    first: float, second: float, needed: bool
) -> None:
    observed = observe(table(), 0.1, depth=True)[:2]
    shapes = [balls(on_what_moves(one, share), 0.0) for one, share in zip(observed, (first, second), strict=True)]
    assert are_needed(observed, shapes).tolist() == [needed]
    assert are_needed(observed, [balls(np.full((1, 3), 50.0), 0.0)] * 2).tolist() == [False]
