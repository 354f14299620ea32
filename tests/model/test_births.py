"""What is born where a rendering does not explain an image."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from model_scenes import block, joined, table
from test_steps import CAMERAS, MOST, balls, look_at, observe

from twin_node.model import birth_depths
from twin_node.model.births import SPREAD, Births, block_side, find_births_reference
from twin_node.model.compiled_births import find_births
from twin_node.model.compiled_deaths import refuted_moving
from twin_node.model.kernels import kernels
from twin_node.model.rays import look


def test_unexplained_pixels_become_gaussians_inside_the_block() -> None:
    births = find_births(observe(table(), 0.1), look_at(table()), MOST)
    free = births.means[~births.on_background]
    assert len(free) > 60
    inside = (np.abs(free - [0.1, 0, 0.05]) < [0.14, 0.14, 0.11]).all(1)
    assert inside.mean() > 0.85


@pytest.mark.parametrize("find", [find_births, find_births_reference])
@pytest.mark.parametrize("side", [4, 6, 200])
def test_what_is_of_one_colour_is_covered_by_few_large_blocks_and_small_ones_around(
    find: Callable[..., Births], side: int
) -> None:
    red = [
        replace(one, rgb=np.where(one.active[..., None], np.float32([0.8, 0.1, 0.1]), one.rgb))
        for one in observe(table(), 0.1, depth=True)
    ]
    given = (red, look_at(table()), 10_000)
    small, large = sides_of(find(*given)), sides_of(find(*given, side))
    assert set(small) == {2}
    assert set(large) == ({2, side} if side < 90 else {2})
    assert np.square(large).sum() == pytest.approx(np.square(small).sum(), rel=0.05), "views that see no change differ"
    assert (len(large) < 0.7 * len(small)) == (side < 90)


def sides_of(births: Births) -> np.ndarray:
    """[n] of the blocks, in pixels, that births stand for."""
    depths = [look(CAMERAS[view], mean[None]).depth[0] for view, mean in zip(births.views, births.means, strict=True)]
    return (births.radii * CAMERAS[0].K[0, 0] / (SPREAD * np.array(depths))).round().astype(int)


def test_blocks_grow_with_the_images_that_the_same_room_must_cover() -> None:
    sizes = [block_side(3 * width * width * 9 // 16, 1000) for width in (80, 160, 320, 640, 1280)]
    assert sizes == [2, 2, 4, 10, 18]
    assert block_side(3 * 160 * 90, 0) > 32, "no room at all"


def test_nothing_is_born_where_a_camera_sees_through_it() -> None:
    observed = observe(table(), 0.1, blind=1)
    births = find_births(observed, look_at(table()), MOST)
    seen = births.means[~births.on_background]
    assert not refuted_moving(observed, [balls(seen, 0.0)] * 3, np.ones(len(seen), bool)).any()


def test_measured_depth_places_births_on_the_surface() -> None:
    births = find_births(observe(table(), 0.1, depth=True), look_at(table()), MOST)
    free = births.means[~births.on_background]
    assert len(free) > 60
    outside = np.maximum(np.abs(free - [0.1, 0, 0.05]) - [0.08, 0.08, 0.05], 0)
    assert np.percentile(np.linalg.norm(outside, axis=1), 80) < 0.03


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
@pytest.mark.parametrize("depth", [False, True])
@pytest.mark.parametrize("blind", [None, 1])
@pytest.mark.parametrize("shown_x", [None, 0.05])
@pytest.mark.parametrize("side", [2, 4])
def test_compiled_births_are_those_found_in_numpy(
    depth: bool, blind: int | None, shown_x: float | None, side: int
) -> None:
    noise = np.random.default_rng(4)
    shown = look_at(table() if shown_x is None else joined(table(), block(shown_x)))
    observed = []
    for one in observe(table(), 0.1, depth, blind):
        rgb = np.clip(one.rgb + noise.normal(0, 0.02, one.rgb.shape), 0, 1).astype(np.float32)
        usable, stale = (noise.random(one.usable.shape) < share for share in (0.95, 0.1))
        observed.append(replace(one, rgb=rgb, usable=one.usable & usable, stale=stale))
    given = (observed, shown, 150, side)
    found, expected = find_births(*given), find_births_reference(*given)
    assert len(expected) > 120 / side**2
    assert len(found) == len(expected)
    for name, values in vars(expected).items():
        assert vars(found)[name] == pytest.approx(values, rel=1e-6), name


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
@pytest.mark.parametrize("side", [2, 4])
def test_what_is_too_close_to_a_camera_is_so_for_the_kernel_too(monkeypatch: pytest.MonkeyPatch, side: int) -> None:
    given = (observe(table(), 0.1), look_at(table()), MOST, side)
    as_they_are = find_births_reference(*given).means
    monkeypatch.setattr(birth_depths, "HUGE", 1.0)
    found, expected = find_births(*given), find_births_reference(*given)
    assert found.means == pytest.approx(expected.means, rel=1e-6)
    assert len(expected) != len(as_they_are) or np.abs(expected.means - as_they_are).max() > 0.01, "it tells"


def test_an_explained_image_bears_nothing() -> None:
    births = find_births(observe(table(), 0.1), look_at(joined(table(), block(0.1))), MOST)
    assert len(births) == 0
