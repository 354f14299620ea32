"""Cameras whose first images are black or burnt out, and cameras that join later."""

from __future__ import annotations

import copy
from dataclasses import replace

import numpy as np
import pytest
from model_scenes import TICK_NS, camera, frames, rig

from twin_node.model import ModelParameters, SeedParameters, WindowModel
from twin_node.model.first_light import PATIENCE_S, FirstLight, is_blind, once_lit
from twin_node.model.quality import psnr, squared_error
from twin_node.scene import FrameSet, Tier, TwinState, View

QUICK = ModelParameters(seed=SeedParameters(steps=24), gaussians_per_pixel=0.5)
CAMERAS = rig()
STILL = frames(0, -0.15, CAMERAS)
MEASURED = frames(0, -0.15, CAMERAS, depth=True)


def at(index: int, one: FrameSet, *views: View) -> FrameSet:
    """Set `index` of a scene at rest, with `views` in place of the first ones."""
    stamp = STILL.stamp + index * TICK_NS
    shown = (*views, *one.views[len(views) :])
    return FrameSet(stamp, tuple(replace(view, stamp=stamp) for view in shown), sequence=index)


def flat(view: View, level: int) -> View:
    """The view with every pixel at `level`, but for some that are hot."""
    rgb = np.full_like(view.rgb, level)
    rgb[::16, ::16] = 200
    return replace(view, rgb=rgb)


@pytest.mark.parametrize("level", [0, 10, 255])
def test_who_shows_nothing_is_left_out_until_it_shows_something(level: int) -> None:
    light, view = FirstLight(), STILL.views[0]
    seen = light.heed(at(0, STILL, flat(view, level)))
    assert [is_blind(one) for one in seen.views] == [True, False, False]
    assert light.warnings and "cam0" in light.warnings[0]
    lit = at(1, STILL)
    assert light.heed(lit) is not lit and not any(is_blind(one) for one in light.heed(lit).views)
    assert not light.warnings
    gone_dark = at(2, STILL, flat(view, level))
    assert light.heed(gone_dark) is gone_dark, "it has shown what stands there"


def test_who_measures_depth_is_not_waited_for_for_ever() -> None:
    dark = [flat(view, 0) for view in MEASURED.views]
    light, late = FirstLight(), round(PATIENCE_S * 1e9 / TICK_NS) + 1
    assert light.is_dark(at(0, MEASURED, *dark))
    assert light.is_dark(at(late - 2, MEASURED, *dark))
    assert not light.is_dark(at(late, MEASURED, *dark))
    blind = FirstLight()
    assert blind.is_dark(at(0, STILL, *(replace(one, depth=None) for one in dark)))
    assert blind.is_dark(at(late, STILL, *(replace(one, depth=None) for one in dark)))


def test_who_leaves_without_having_shown_anything_is_not_told_of_for_ever_and_waited_for_anew() -> None:
    light, dark, late = FirstLight(), flat(MEASURED.views[0], 0), round(PATIENCE_S * 1e9 / TICK_NS) + 1
    others = replace(MEASURED, views=MEASURED.views[1:])
    light.heed(at(0, MEASURED, dark))
    light.heed(at(late - 2, others))
    assert light.warnings, "images get lost"
    assert not is_blind(copy.deepcopy(light).heed(at(3 * late, MEASURED, dark)).views[0]), "it waited"
    light.heed(at(late, others))
    assert not light.warnings
    assert is_blind(light.heed(at(late + 1, MEASURED, dark)).views[0]), "its exposure has had no time to settle"
    assert light.warnings


def test_a_first_set_that_is_all_dark_is_taken_as_it_is() -> None:
    light, dark = FirstLight(), at(0, STILL, *(flat(view, 0) for view in STILL.views))
    assert light.begin(dark) is dark
    assert light.heed(at(1, dark)).views[0].valid is None


def test_a_model_is_begun_with_the_first_set_that_shows_something() -> None:
    views = STILL.views
    dark = [at(index, STILL, *(flat(view, 0) for view in views)) for index in range(4)]
    half_lit = at(2, STILL, flat(views[0], 0))
    lit = at(3, STILL)
    assert list(once_lit([dark[0], dark[1], half_lit, lit])) == [half_lit, lit]
    assert list(once_lit([lit, dark[3]])) == [lit, dark[3]], "later darkness is part of the recording"
    assert not list(once_lit(dark))


@pytest.mark.parametrize("depth", [False, True])
def test_a_camera_that_begins_black_is_as_good_as_one_that_joins(depth: bool) -> None:
    model, scene = WindowModel(QUICK), MEASURED if depth else STILL
    first = model.update(at(0, scene, flat(scene.views[0], 0)))
    assert any("cam0 has shown nothing" in warning for warning in first.warnings)
    for index in range(1, 8):
        state = model.update(at(index, scene))
    assert not state.warnings
    assert not any(mask.any() for mask in state.moving_masks), "nothing has moved"
    errors = [squared_error(model.render(view.camera).rgb, view.rgb / 255).mean() for view in scene.views]
    assert min(psnr(error) for error in errors) > 22


def test_a_camera_that_joins_in_another_light_is_levelled() -> None:
    model = WindowModel(QUICK)
    model.update(replace(at(0, STILL), views=at(0, STILL).views[1:]))
    dim = replace(STILL.views[0], rgb=(0.5 * STILL.views[0].rgb).round().astype(np.uint8))
    state = model.update(at(1, STILL, dim))
    assert state.exposures[0].gains == pytest.approx(0.5, rel=0.12)
    assert np.abs(state.frames.views[0].rgb.astype(float) - STILL.views[0].rgb).mean() < 12
    assert state.exposures[1].is_plain


def test_a_camera_that_joins_and_sees_what_nobody_did_keeps_its_light() -> None:
    model = WindowModel(QUICK)
    model.update(replace(at(0, STILL), views=at(0, STILL).views[1:]))
    noise = np.random.default_rng(0).integers(0, 255, STILL.views[0].rgb.shape, np.uint8)
    state = model.update(at(1, STILL, replace(STILL.views[0], rgb=noise)))
    assert state.exposures[0].is_plain


@pytest.mark.parametrize("depth", [False, True])
def test_what_moves_before_a_camera_that_joins_and_looks_away_from_the_others_is_followed(depth: bool) -> None:
    """It stands beyond the shell of the first: that lay behind it, and the model ended in numbers that were none."""
    away, model = camera("away", (6.0, 0.0, 1.0), (12.0, 0.0, 0.0)), WindowModel(QUICK)
    for index in range(12):
        first = frames(index, -0.15, CAMERAS[:1], depth)
        rgb = np.random.default_rng(0).integers(60, 200, (away.height, away.width, 3), np.uint8)
        measured = np.full(rgb.shape[:2], 3, np.float32)
        rgb[20:40, 4 * index : 4 * index + 20], measured[20:40, 4 * index : 4 * index + 20] = (255, 80, 0), 1.5
        joins = (View(away, first.stamp, rgb, measured if depth else None),) if index > 2 else ()
        cloud = model.update(replace(first, views=(*first.views, *joins))).gaussians
    moving = cloud.means[cloud.tiers != Tier.STATIC]
    assert len(moving) > 20 and (moving[:, 0] > 6).all()


@pytest.mark.parametrize("depth", [False, True])
def test_who_stands_before_a_camera_that_joins_is_no_ground_to_it(depth: bool) -> None:
    """Others see them move: without depth it is left out until nobody does."""
    cameras, model = CAMERAS, WindowModel(QUICK)

    def looked(index: int, block_x: float | None) -> TwinState:
        one = frames(3 * index, block_x, cameras, depth)
        joins = index < 5
        return model.look(replace(one, views=one.views[joins:]))

    for index in range(5):
        looked(index, None if index == 0 else -0.3 + 0.06 * index)
    come = looked(5, 0.0)
    assert any("cam0 measures no depth" in warning for warning in come.warnings) != depth
    assert is_blind(come.frames.views[0]) != depth
    for index in range(6, 20):
        gone = looked(index, None)
    assert not gone.warnings
    assert not is_blind(gone.frames.views[0])


@pytest.mark.parametrize("depth", [False, True])
def test_who_stands_before_a_camera_whose_images_change_their_size_is_no_ground_to_it(depth: bool) -> None:
    coarse = (rig(56, 42)[0], *CAMERAS[1:])
    model = WindowModel(QUICK)
    for index in range(5):
        model.look(frames(3 * index, None if index == 0 else -0.3 + 0.06 * index, CAMERAS, depth))
    come = model.look(frames(15, 0.0, coarse, depth))
    assert any("cam0 measures no depth" in warning for warning in come.warnings) != depth
    assert is_blind(come.frames.views[0]) != depth
    for index in range(6, 20):
        gone = model.look(frames(3 * index, None, coarse, depth))
    assert not gone.warnings
    assert not is_blind(gone.frames.views[0])


def test_a_camera_whose_images_change_their_size_in_the_dark_is_levelled_once_it_shows_something() -> None:
    """What it had shown in the dark was remembered as what it sees at rest, beside which no exposure was ever told."""
    coarse, model = frames(0, -0.15, (rig(56, 42)[0], *CAMERAS[1:])), WindowModel(QUICK)
    model.update(at(0, STILL))
    dark = model.update(at(1, coarse, flat(coarse.views[0], 0)))
    assert is_blind(dark.frames.views[0])
    for index in range(2, 4):
        dim = replace(coarse.views[0], rgb=(0.5 * coarse.views[0].rgb).round().astype(np.uint8))
        state = model.update(at(index, coarse, dim))
    assert state.exposures[0].gains == pytest.approx(0.5, rel=0.12)
    assert np.abs(state.frames.views[0].rgb.astype(float) - coarse.views[0].rgb).mean() < 12
