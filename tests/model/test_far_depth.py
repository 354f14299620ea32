"""Depth that no camera can have measured: a sensor's word for nothing, and wrong units."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from model_scenes import camera, frames, rig, sliding

from twin_node.model import ModelParameters, SeedParameters, WindowModel
from twin_node.model.far_depth import FarDepth
from twin_node.scene import Float64, FrameSet, Tier

QUICK = ModelParameters(seed=SeedParameters(steps=24), gaussians_per_pixel=0.5)
CAMERAS = rig()


def spoilt(one: FrameSet, depth: float, share: float) -> FrameSet:
    """The set in which a share of the first camera's depth is `depth`."""
    view = one.views[0]
    assert view.depth is not None
    wrong = np.random.default_rng(one.sequence).random(view.depth.shape) < share
    changed = replace(view, depth=np.where(wrong, np.float32(depth), view.depth))
    return replace(one, views=(changed, *one.views[1:]))


@pytest.mark.parametrize(("depth", "share"), [(65.535, 0.3), (1e6, 0.3), (1e6, 1.0)])
def test_what_is_impossibly_far_is_as_if_it_had_not_been_measured(depth: float, share: float) -> None:
    with_it, without = WindowModel(QUICK), WindowModel(QUICK)
    for one in sliding(12, CAMERAS, depth=True):
        is_whole = one.sequence < 4
        state = with_it.update(one if is_whole else spoilt(one, depth, share))
        expected = without.update(one if is_whole else spoilt(one, 0.0, share))
    np.testing.assert_array_equal(state.gaussians.means, expected.gaussians.means)
    for view, other in zip(state.frames.views, expected.frames.views, strict=True):
        np.testing.assert_array_equal(view.depth, other.depth)
    assert with_it.tier_counts[Tier.STATIC] == without.tier_counts[Tier.STATIC]
    assert any("cam0" in warning and "metres" in warning for warning in state.warnings) == (share > 0.5)


def test_a_first_set_in_millimetres_is_seeded_as_without_depth() -> None:
    one = frames(0, -0.15, CAMERAS, depth=True)
    views = tuple(replace(view, depth=1000 * np.asarray(view.depth)) for view in one.views)
    model = WindowModel(QUICK)
    state = model.update(replace(one, views=views))
    assert np.abs(state.gaussians.means).max() < 10
    assert len(state.warnings) == len(CAMERAS)


def test_the_wall_of_a_hall_is_measured() -> None:
    one = frames(0, -0.15, CAMERAS, depth=True)
    wall = replace(one.views[0], depth=np.full(one.views[0].rgb.shape[:2], 20, np.float32))
    hall = replace(one, views=(wall, *one.views[1:]))
    far = FarDepth(CAMERAS)
    assert far.without(hall) is hall and not far.warnings


def test_the_end_of_sixteen_bits_is_far_for_any_rig() -> None:
    cameras = tuple(camera(f"cam{i}", eye, width=8, height=6) for i, eye in enumerate([(9, 0, 4), (0, 9, 4)]))
    one = frames(0, None, cameras, depth=True)
    views = tuple(replace(view, depth=np.full((6, 8), 65.535, np.float32)) for view in one.views)
    seen = FarDepth(cameras).without(replace(one, views=views))
    assert not any(np.any(view.depth) for view in seen.views)


def test_a_rig_that_stands_near_what_it_looks_at_measures_a_room() -> None:
    """25 times as far as cameras stand from the thing between them would be the wall behind it."""
    near = [replace(one, T_base_cam=_nearer(one.T_base_cam)) for one in CAMERAS]
    one = frames(0, None, near, depth=True)
    walls = replace(one, views=tuple(replace(view, depth=np.full_like(view.depth, 8.0)) for view in one.views))
    assert FarDepth(near).without(walls) is walls


def _nearer(T_base_cam: Float64) -> Float64:
    """Towards where the cameras look, a tenth as far from it."""
    T = T_base_cam.copy()
    T[:3, 3] *= 0.1
    return T
