"""What depth says of single Gaussians: what is measured is needed, what is seen through is not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from model_scenes import block, joined, table
from test_steps import balls, look_at, observe

from twin_node.model.compiled_deaths import judge_static
from twin_node.model.deaths import (
    SEEN_THROUGH,
    StaticEvidence,
    are_needed,
    clashing,
    judge_static_reference,
    seen_through,
)
from twin_node.model.observation import Observed
from twin_node.model.quality import MOVING_THRESHOLD
from twin_node.model.rays import back_project, look
from twin_node.model.rendering import Rendering
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


class Judged:
    """A Gaussian that stands off the plane, or lies on it, and that views see without anything before it."""

    def __init__(self, views: int = 2, on_plane: bool = False) -> None:
        static = joined(table(), block(-0.2))
        self.drawn = look_at(static)[:views]
        self.observed = [replace(one, active=np.zeros_like(one.active)) for one in observe(static, -0.2, True)[:views]]
        heights = static.means[0, :, 2].numpy()
        is_apart = heights == 0 if on_plane else heights > 0.06
        for one in self.observed:
            is_apart &= one.background.static.inside & ~one.background.occluded(one.background.static)
        self.index = int(np.flatnonzero(is_apart)[0])

    def seen(self, view: int, share: float | None, surprise: float, moving: bool) -> None:
        """A view measures a share of its depth (None: none), finds it as different, and as moving or not."""
        one = self.observed[view]
        nearest = None if share is None else np.full_like(one.surprise, share * self.depth(view))
        surprises, moves = np.full_like(one.surprise, surprise), np.full_like(one.moving, moving)
        self.observed[view] = replace(one, nearest=nearest, surprise=surprises, moving=moves)

    def drawn_before(self, view: int, share: float, active: bool) -> None:
        """The model is drawn at a share of its depth (0: nothing is), where something moves or not."""
        one, shown = self.observed[view], self.drawn[view]
        rgbd = shown.rgbd.clone()
        rgbd[..., 3] = share * self.depth(view)
        self.drawn[view] = replace(shown, rgbd=rgbd)
        self.observed[view] = replace(one, active=np.full_like(one.active, active))

    def depth(self, view: int) -> float:
        """Of the Gaussian, m."""
        return float(self.observed[view].background.static.depth[self.index])


JUDGES = pytest.mark.parametrize("judge", [judge_static, judge_static_reference])
Judge = Callable[[list[Observed], list[Rendering]], StaticEvidence]


@JUDGES
@pytest.mark.parametrize(
    ("share", "left"),
    [(1.0, False), (1 - 0.8 * SEEN_THROUGH, False), (1 - 1.2 * SEEN_THROUGH, True), (0.5, True)],
)
def test_what_depth_measures_in_its_place_stays_though_another_view_shows_something_else(
    judge: Judge, share: float, left: bool
) -> None:
    """A surface well before it hides it from the view that measures: then the other alone decides."""
    one = Judged()
    one.seen(0, share, 1.0, moving=False)
    one.seen(1, None, 2 * MOVING_THRESHOLD, moving=False)
    assert bool(judge(one.observed, one.drawn).left[one.index]) == left


@JUDGES
@pytest.mark.parametrize(("share", "moves"), [(1 - 0.8 * SEEN_THROUGH, True), (1 - 1.2 * SEEN_THROUGH, False)])
def test_what_moves_well_before_a_gaussian_tells_nothing_of_it(judge: Judge, share: float, moves: bool) -> None:
    one = Judged()
    one.seen(0, share, 0.0, moving=True)
    one.seen(1, 1.0, 0.0, moving=True)
    assert bool(judge(one.observed, one.drawn).moving[one.index]) == moves


@JUDGES
def test_what_one_view_alone_shows_among_what_moves_moves_only_where_there_is_no_other(judge: Judge) -> None:
    one = Judged()
    one.seen(0, None, 0.0, moving=True)
    one.seen(1, 0.5, 0.0, moving=False)
    assert not judge(one.observed, one.drawn).moving[one.index]
    assert judge(one.observed[:1], one.drawn[:1]).moving[one.index]


@JUDGES
@pytest.mark.parametrize("third", [True, False])
def test_what_one_view_shows_at_rest_does_not_move_whatever_others_show(judge: Judge, third: bool) -> None:
    one = Judged(views=3)
    for view, moving in enumerate((True, True, third)):
        one.seen(view, None, 0.0, moving)
    assert bool(judge(one.observed, one.drawn).moving[one.index]) == third


@JUDGES
@pytest.mark.parametrize(
    ("share", "active", "left"), [(0.8, True, False), (0.8, False, True), (0.99, True, True), (0.0, True, True)]
)
def test_what_stands_behind_something_that_moves_is_covered_and_not_gone(
    judge: Judge, share: float, active: bool, left: bool
) -> None:
    """What is drawn in its very place, or where nothing moves, covers nothing."""
    one = Judged()
    for view in range(2):
        one.seen(view, None, 1.0, moving=False)
        one.drawn_before(view, share, active)
    assert bool(judge(one.observed, one.drawn).left[one.index]) == left


@JUDGES
@pytest.mark.parametrize(("surprise", "left"), [(0.9, False), (1.1, True)])
def test_what_every_view_that_should_show_it_shows_otherwise_has_left(
    judge: Judge, surprise: float, left: bool
) -> None:
    one = Judged()
    one.seen(0, None, 1.0, moving=False)
    one.seen(1, None, surprise * MOVING_THRESHOLD, moving=False)
    assert bool(judge(one.observed, one.drawn).left[one.index]) == left


@JUDGES
def test_what_one_view_measures_depth_behind_has_left_whatever_others_show(judge: Judge) -> None:
    one = Judged()
    one.seen(0, 1 + 1.2 * SEEN_THROUGH, 0.0, moving=False)
    one.seen(1, 1.0, 0.0, moving=False)
    assert not judge(one.observed, one.drawn).left[one.index], "nothing has been active there"
    one.drawn_before(0, 0.0, active=True)
    assert judge(one.observed, one.drawn).left[one.index]


@JUDGES
@pytest.mark.parametrize("usable", [True, False])
def test_pixels_that_do_not_count_speak_neither_for_nor_against_what_stands(judge: Judge, usable: bool) -> None:
    one = Judged()
    one.seen(0, None, 0.0, moving=False)
    one.seen(1, None, 1.0, moving=False)
    one.observed[0] = replace(one.observed[0], usable=np.full_like(one.observed[0].usable, usable))
    assert bool(judge(one.observed, one.drawn).left[one.index]) != usable, "shown unchanged by a view that counts"


@JUDGES
def test_what_lies_on_the_plane_leaves_by_measured_depth_alone_and_never_moves(judge: Judge) -> None:
    one = Judged(on_plane=True)
    for view in range(2):
        one.seen(view, None, 1.0, moving=True)
    told = judge(one.observed, one.drawn)
    assert not told.left[one.index] and not told.moving[one.index]
    one.seen(0, 1 + 1.2 * SEEN_THROUGH, 0.0, moving=False)
    one.drawn_before(0, 0.0, active=True)
    assert judge(one.observed, one.drawn).left[one.index]


def test_a_view_sees_through_nothing_that_is_beyond_its_image() -> None:
    """Depth is measured at the image's edge, far behind where the point would be."""
    one = observe(table(), 0.1, depth=True)[0]
    one = replace(one, active=np.ones_like(one.active), nearest=np.full_like(one.surprise, 9.0))
    camera = one.view.camera
    ahead, right = camera.T_base_cam[:3, 2], camera.T_base_cam[:3, 0]
    points = camera.T_base_cam[:3, 3] + np.stack([ahead, ahead + 3 * right, -ahead])
    assert seen_through(one, look(camera, points)).tolist() == [True, False, False]


@pytest.mark.parametrize(("channels", "clashes"), [((0.25, 0.0, 0.0), True), ((0.15, 0.15, 0.15), False)])
def test_colours_clash_by_the_channel_that_differs_most(channels: tuple[float, ...], clashes: bool) -> None:
    one = Judged()
    one.seen(0, 2.0, 0.0, moving=False)
    one.drawn_before(0, 1.0, active=True)
    seeing, count = one.observed[0], len(one.observed[0].background.static.rows)
    colour = seeing.rgb[seeing.background.static.rows, seeing.background.static.columns][one.index] + channels
    left = np.arange(count) == one.index
    found = clashing([seeing], left, torch.from_numpy(np.tile(np.float32(colour), (count, 1))))
    assert bool(found[one.index]) == clashes
    assert np.count_nonzero(found) == clashes
