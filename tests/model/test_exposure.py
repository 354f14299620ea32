"""Exposure: what light and shutter do to whole images is undone, what happens in the scene is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from model_scenes import frames, rig

from twin_node.model import ModelParameters, WindowModel
from twin_node.model.balance import balance
from twin_node.model.exposure import Exposures, fit_exposure, levelled
from twin_node.model.kernels import kernels
from twin_node.model.parameters import SeedParameters
from twin_node.model.quality import psnr, squared_error
from twin_node.model.remembered import SATURATED, Remembered
from twin_node.model.seeding import find_plane, find_surfaces
from twin_node.scene import PLAIN, Exposure, Float32, FrameSet, View

NOBODY = (None, None, None)


def exposed(view: View, gain: float, offset: float = 0.0) -> View:
    """A view as a camera of another exposure would have given it."""
    return replace(view, rgb=np.clip(gain * view.rgb + 255 * offset + 0.5, 0, 255).astype(np.uint8))


def under(set_: FrameSet, *gains: float) -> FrameSet:
    """A set whose views are exposed by these gains, in turn."""
    views = zip(set_.views, gains, strict=True)
    return replace(set_, views=tuple(exposed(view, gain) for view, gain in views))


@given(st.floats(0.1, 2.0), st.floats(-0.05, 0.05), st.integers(0, 2**31))
@settings(max_examples=60, deadline=None)
def test_gain_and_offset_are_found_beside_what_changes_in_the_scene(gain: float, haze: float, seed: int) -> None:
    offset = gain * haze
    rng = np.random.default_rng(seed)
    shown = (rng.uniform(0.1, 0.9, (800, 1)) * rng.uniform(0.7, 1.0, (800, 3))).astype(np.float32)
    seen = np.clip(gain * shown + offset + 0.005 * rng.standard_normal(shown.shape), 0, 1)
    seen[:160] = rng.uniform(0, 1, (160, 3))  # a fifth shows something new
    found = fit_exposure(shown, (np.round(255 * seen) / 255).astype(np.float32), PLAIN)
    clear = gain * shown + offset < 0.95
    assert np.abs(found.of(shown) - np.clip(gain * shown + offset, 0, 1))[clear].max() < 0.04 * max(gain, 0.5) + 0.01


def test_half_the_image_painted_over_is_no_exposure() -> None:
    rng = np.random.default_rng(0)
    shown = rng.uniform(0.1, 0.9, (800, 3)).astype(np.float32)
    seen = shown.copy()
    seen[:420] *= 0.4
    assert fit_exposure(shown, seen, PLAIN) is PLAIN


@pytest.mark.parametrize("gain", [0.0, 0.02])
def test_darkness_is_no_exposure(gain: float) -> None:
    shown = np.random.default_rng(0).uniform(0.1, 0.9, (800, 3)).astype(np.float32)
    assert fit_exposure(shown, gain * shown, PLAIN) is PLAIN


@pytest.mark.parametrize("share", [0.1, 0.12])
def test_light_that_is_switched_on_is_told_by_who_began_in_the_dark(share: float) -> None:
    """No single colour is bright enough to tell a ratio."""
    rng = np.random.default_rng(0)
    seen = (rng.uniform(0.15, 0.6, (800, 1)) * rng.uniform(0.6, 1.0, (800, 3))).astype(np.float32)
    shown = (np.round(255 * share * seen + rng.normal(0, 0.3, seen.shape)) / 255).clip(0, 1).astype(np.float32)
    found = fit_exposure(shown, seen, PLAIN)
    assert np.abs(share * found.gains - 1).max() < 0.1


def test_an_image_in_the_usual_light_is_left_alone_to_the_bit() -> None:
    exposures, first = Exposures(), frames(0, None, rig())
    exposures.begin(first, (PLAIN,) * 3)
    for index in range(1, 4):
        level = exposures.level(frames(index, 0.1 * index, rig()), NOBODY)
        assert all(exposure is PLAIN for exposure in level.exposures)
        for even, view in zip(level.frames.views, frames(index, 0.1 * index, rig()).views, strict=True):
            np.testing.assert_array_equal(even.rgb, view.rgb)


def test_each_camera_is_levelled_by_its_own_exposure_and_comes_back_to_the_usual_one() -> None:
    exposures, still = Exposures(), frames(0, None, rig())
    exposures.begin(still, (PLAIN,) * 3)
    dark = exposures.level(under(still, 0.25, 1.0, 0.6), NOBODY)
    assert [exposure.brightness for exposure in dark.exposures] == pytest.approx([0.25, 1.0, 0.6], abs=0.01)
    for even, view in zip(dark.frames.views, still.views, strict=True):
        assert np.abs(even.rgb.astype(int) - view.rgb).max() <= 4
    assert len(dark.warnings) == 0
    assert len(exposures.level(under(still, 0.2, 0.2, 0.2), NOBODY).warnings) == 3
    assert all(exposure is PLAIN for exposure in exposures.level(still, NOBODY).exposures)


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
@given(st.floats(0.05, 1.6), st.floats(-0.1, 0.1), st.floats(0.0, 1.0), st.integers(0, 2**31))
@settings(max_examples=40, deadline=None)
def test_the_compiled_kernels_tell_and_remember_what_numpy_does(
    gain: float, offset: float, share: float, seed: int
) -> None:
    rng = np.random.default_rng(seed)
    before = rng.integers(0, 256, (61, 83, 3), dtype=np.uint8)
    compiled, plain = Remembered(before), Remembered(before)
    exposure = Exposure(np.full(3, gain, np.float32), np.full(3, offset, np.float32))
    for _ in range(3):
        noisy = gain * before + 255 * offset + rng.normal(0, 8, before.shape)
        rgb, still = np.clip(noisy, 0, 255).astype(np.uint8), rng.random((61, 83)) < share
        one, other = compiled.ratios(rgb, still, exposure), plain.ratios_reference(rgb, still, exposure)
        assert one.still == other.still
        assert (one.middle is None) == (other.middle is None)
        if one.middle is not None and other.middle is not None:
            assert np.array_equal(one.middle, other.middle)
        compiled.take(rgb, still)
        plain.take_reference(rgb, still)
        assert np.array_equal(compiled.newest, plain.newest)
        assert np.array_equal(compiled.samples, plain.samples)


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
def test_images_that_lie_otherwise_in_memory_are_remembered_alike() -> None:
    """Those of cameras that hang askew are often turned without a copy."""
    rng = np.random.default_rng(0)
    turned = np.rot90(rng.integers(0, 256, (61, 83, 3), dtype=np.uint8))
    compiled, plain, still = Remembered(turned), Remembered(turned), np.ones(turned.shape[:2], bool)
    next_one = np.clip(turned.astype(int) + rng.integers(-4, 5, turned.shape), 0, 255).astype(np.uint8)
    one, other = compiled.ratios(next_one, still, PLAIN), plain.ratios_reference(next_one, still, PLAIN)
    assert one.middle is not None and other.middle is not None
    np.testing.assert_array_equal(one.middle, other.middle)
    compiled.take(next_one, still)
    plain.take_reference(next_one, still)
    np.testing.assert_array_equal(compiled.samples, plain.samples)
    np.testing.assert_array_equal(compiled.newest, plain.newest)


def test_what_is_too_bright_to_tell_does_not_count_unless_its_depth_is_measured() -> None:
    for depth in (False, True):
        exposures, still = Exposures(), frames(0, None, rig(), depth=depth)
        exposures.begin(still, (PLAIN,) * 3)
        bright = under(still, 3.0, 3.0, 3.0)
        for view, lit, even in zip(
            still.views, bright.views, exposures.level(bright, NOBODY).frames.views, strict=True
        ):
            burnt = (lit.rgb >= 250).any(-1)
            assert burnt.mean() > 0.1
            assert even.valid is not None
            if view.depth is None:
                np.testing.assert_array_equal(even.valid, ~burnt)
            else:
                told = burnt & (view.depth > 0)
                assert even.valid[told].all()
                np.testing.assert_array_equal(even.rgb[told], view.rgb[told])


@pytest.mark.parametrize("is_missed", [False, True])
def test_what_moved_in_the_last_image_does_not_tell_the_exposure(is_missed: bool) -> None:
    """Whether or not its camera is missing from a set since."""
    exposures, still = Exposures(), frames(0, None, rig())
    exposures.begin(still, (PLAIN,) * 3)
    covered = np.zeros((60, 80), bool)
    covered[:, :48] = True
    exposures.heed(still, (covered,) * 3)
    if is_missed:
        exposures.heed(replace(still, views=still.views[1:]), (covered,) * 2)
    view = still.views[0]
    painted = exposed(view, 0.5).rgb
    painted[:, :48] = 40
    told = exposures.level(replace(still, views=(replace(view, rgb=painted), *still.views[1:])), NOBODY)
    assert told.exposures[0].brightness == pytest.approx(0.5, abs=0.01)


def test_a_levelled_view_is_the_view_before_its_exposure() -> None:
    view = frames(0, None, rig()).views[0]
    exposure = Exposure(np.array([0.5, 0.6, 0.7], np.float32), np.array([0.02, 0.0, -0.01], np.float32))
    seen = (255 * exposure.of(view.rgb / np.float32(255)) + 0.5).astype(np.uint8)
    even = levelled(replace(view, rgb=seen), exposure)
    assert np.abs(even.rgb.astype(int) - view.rgb)[seen > 0].max() <= 2


def test_cameras_that_begin_exposed_unlike_each_other_are_balanced() -> None:
    first = under(frames(0, None, rig(), depth=True), 1.0, 0.7, 0.5)
    surfaces = find_surfaces(first.views, find_plane(first.views), SeedParameters())
    gains = np.array([exposure.gains for exposure in balance(first.views, surfaces)])
    np.testing.assert_allclose(gains / gains[0], np.array([1.0, 0.7, 0.5])[:, None] * np.ones(3), rtol=0.05)
    np.testing.assert_allclose(gains.prod(0), 1, rtol=1e-4)


def test_cameras_exposed_alike_are_not_balanced() -> None:
    first = frames(0, None, rig(), depth=True)
    surfaces = find_surfaces(first.views, find_plane(first.views), SeedParameters())
    assert all(exposure is PLAIN for exposure in balance(first.views, surfaces))


def _db(model: WindowModel, set_: FrameSet) -> float:
    errors: list[Float32] = [
        squared_error(model.render(view.camera).rgb, view.rgb / np.float32(255)) for view in set_.views
    ]
    return psnr(float(np.mean(errors)))


def test_light_that_goes_out_and_on_changes_neither_the_models_colours_nor_its_size() -> None:
    parameters = ModelParameters(seed=SeedParameters(steps=24))
    lit, dimmed = WindowModel(parameters), WindowModel(parameters)
    for index in range(8):
        set_ = frames(index, 0.01 * index, rig(), depth=True)
        state = lit.update(set_)
        dark = dimmed.update(set_ if index % 4 < 2 else under(set_, 0.4, 0.4, 0.4))
    assert [exposure.brightness for exposure in dark.exposures] == pytest.approx([0.4] * 3, abs=0.01)
    assert _db(dimmed, set_) > _db(lit, set_) - 0.5
    assert abs(len(dark.gaussians.ids) - len(state.gaussians.ids)) < 0.02 * len(state.gaussians.ids)
    assert dark.exposure_of("cam1").brightness == pytest.approx(0.4, abs=0.01)
    assert dark.exposure_of("another") is PLAIN


def test_light_that_the_usual_exposure_explains_as_well_is_the_usual_one() -> None:
    shown = np.random.default_rng(0).uniform(0.1, 0.9, (800, 3)).astype(np.float32)
    assert fit_exposure(shown, shown.copy(), PLAIN) is PLAIN


def test_of_what_is_too_bright_only_what_stands_keeps_its_colour_and_what_was_invalid_stays_so() -> None:
    exposures, still = Exposures(), frames(0, None, rig(), depth=True)
    valid = np.ones(still.views[0].rgb.shape[:2], bool)
    valid[:, :8] = False
    still = replace(still, views=tuple(replace(view, valid=valid) for view in still.views))
    exposures.begin(still, (PLAIN,) * 3)
    moving = np.zeros_like(valid)
    moving[:, 48:] = True
    exposures.heed(still, (moving,) * 3)
    bright = under(still, 3.0, 3.0, 3.0)
    for view, lit, even in zip(still.views, bright.views, exposures.level(bright, NOBODY).frames.views, strict=True):
        burnt = lit.rgb.max(-1) >= SATURATED
        assert (burnt & moving).any() and view.depth is not None
        assert even.valid is not None
        np.testing.assert_array_equal(even.valid, valid & ~(burnt & (view.depth <= 0)))
        assert view.rgb[burnt & moving].max() > 150
        assert even.rgb[burnt & moving].max() <= 110, "about a third of what is too bright: the least that it can be"
