"""What is seen to move against the forecast made for it: by points where depth is measured, else by pixels."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from forecast_worlds import GRID, RIG, ball_voxels, state_of
from numpy.typing import NDArray

from twin_node.forecast.judgement import Held, Judgement, Watch
from twin_node.forecast.margin import Margin
from twin_node.forecast.moving_surface import Moving, moving_surface, moving_surface_reference
from twin_node.forecast.parts import Parts
from twin_node.forecast.tables import RigTables

CENTER = np.array([0.1, 0.0, 0.4])
ALL, NONE = np.ones(2, np.bool_), np.zeros(2, np.bool_)


def halves(margin: Margin, voxels: NDArray[np.int64]) -> Parts:
    """Two parts of what is at `voxels` [n] of the inner grid: on this side of `CENTER` along x, and beyond."""
    centers = GRID.centers(voxels)
    places = np.stack(np.unravel_index(voxels, GRID.dims)).astype(np.int32)
    labels = (centers[:, 0] > CENTER[0]).astype(np.int64)
    return Parts(margin.outward(voxels), places, labels, np.ones(len(voxels), np.bool_), np.stack([CENTER, CENTER]))


@pytest.mark.parametrize("depth", [True, False])
def test_what_is_seen_is_held_by_a_forecast_as_far_as_that_reaches(depth: bool) -> None:
    margin = Margin(GRID, 0.15)
    tables, state = RigTables(margin.outer), state_of(0, CENTER, with_depth=depth)
    ball = ball_voxels(CENTER, 0.16)
    half = ball[GRID.centers(ball)[:, 2] > CENTER[2]]
    whole, some, none = (
        Judgement(state, margin, tables, forecast, halves(margin, ball)).of(ALL) for forecast in (ball, half, ball[:0])
    )
    assert whole.seen == some.seen == none.seen > 100
    assert whole.covered == whole.seen and none.covered == 0
    assert 0.2 * whole.seen < some.covered < 0.95 * whole.seen
    assert whole.measured == (whole.seen if depth else 0)


@pytest.mark.parametrize("depth", [True, False])
def test_what_moves_beside_the_workspace_is_not_missed_by_a_forecast_of_the_workspace(depth: bool) -> None:
    margin = Margin(GRID, 0.3)
    beside = np.array([GRID.origin[0] - 0.16, 0.0, 0.4])
    outer = np.arange(margin.outer.size)
    outer = outer[np.linalg.norm(margin.outer.centers(outer) - beside, axis=1) < 0.1]
    places = margin.places(np.stack(np.unravel_index(outer, margin.outer.dims)).astype(np.int32))
    parts = Parts(outer, places, np.zeros(len(outer), np.int64), np.ones(len(outer), np.bool_), beside[None])
    state = state_of(0, beside, with_depth=depth)
    assert any(mask.any() for mask in state.moving_masks)
    assert Judgement(state, margin, RigTables(margin.outer), outer[:0], parts).of(np.ones(1, np.bool_)).seen == 0


def test_points_that_no_other_camera_confirms_are_not_asked_for() -> None:
    margin = Margin(GRID, 0.15)
    ball = ball_voxels(CENTER, 0.16)
    state, parts = state_of(0, CENTER, with_depth=True), halves(margin, ball)
    judgement = Judgement(state, margin, RigTables(margin.outer), ball, parts)
    held, nothing = judgement.of(np.array([False, True])), judgement.of(NONE)
    assert 0 < held.agreed < held.measured and held.seen == held.covered == held.agreed
    assert nothing.seen == nothing.covered == nothing.agreed == 0


def test_of_pixels_those_count_that_show_to_move_where_the_chosen_parts_are() -> None:
    margin = Margin(GRID, 0.15)
    ball, state = ball_voxels(CENTER, 0.16), state_of(0, CENTER)
    tables, parts = RigTables(margin.outer), halves(margin, ball_voxels(CENTER, 0.16))
    judged = Judgement(state, margin, tables, ball, parts)
    one, other, both = (judged.of(np.array(chosen)) for chosen in ([True, False], [False, True], [True, True]))
    assert 0 < one.seen < both.seen and 0 < other.seen < both.seen <= one.seen + other.seen
    still = replace(
        state, moving_masks=(*(np.zeros_like(mask) for mask in state.moving_masks[1:]), state.moving_masks[0])
    )
    assert 0 < Judgement(still, margin, tables, ball, parts).of(ALL).seen < both.seen


@pytest.mark.parametrize(("grown_px", "is_asked"), [(0, False), (5, False), (9, True)])
def test_whether_cameras_see_past_what_is_measured_is_asked_where_much_of_it_is_unexplained(
    grown_px: int, is_asked: bool
) -> None:
    margin = Margin(GRID, 0.15)
    state = state_of(0, CENTER, radius=0.05, cameras=RIG[:1], with_depth=True)
    if grown_px:
        wider = cv2.dilate(state.moving_masks[0].astype(np.uint8), np.ones((grown_px, grown_px), np.uint8)) > 0
        state = replace(state, moving_masks=(wider,))
    ball, asked = ball_voxels(CENTER, 0.08), []
    judgement = Judgement(state, margin, RigTables(margin.outer), ball, halves(margin, ball))
    held = judgement.of(ALL)

    def sees_past(voxels: NDArray[np.int64]) -> NDArray[np.bool_]:
        asked.append(len(voxels))
        return np.zeros(len(voxels), np.bool_)

    assert judgement.of_all(sees_past).agreed == held.agreed
    assert asked == ([held.measured - held.agreed] if is_asked else [])
    assert (held.agreed < held.measured) == (grown_px > 0)


@pytest.mark.parametrize("views", [0, 1, 3])
def test_measured_points_are_found_compiled_as_reference(views: int) -> None:
    margin = Margin(GRID, 0.15)
    ball = ball_voxels(CENTER, 0.16)
    state = state_of(0, CENTER, with_depth=True)
    seen = [Moving(*one) for one in zip(state.frames.views, state.moving_masks, strict=True)][:views]
    parts, forecast = halves(margin, ball[::2]), ball[GRID.centers(ball)[:, 2] > CENTER[2]]
    found, expected = (one(seen, margin, parts, forecast) for one in (moving_surface, moving_surface_reference))
    assert np.array_equal(found.parts, expected.parts)
    assert np.array_equal(found.foreseen, expected.foreseen)
    if views:
        assert {-1, 0, 1} == set(found.parts.tolist())
        assert 0 < np.count_nonzero(found.foreseen) < len(found.foreseen)


def test_cameras_that_contradict_each_other_from_the_start_are_told_of_within_five_judgements() -> None:
    watch, told = Watch(), []
    for _ in range(5):
        watch = watch.after(Held(seen=100, covered=100, measured=300, agreed=105))
        told.append(any("look for mirrors" in line for line in watch.warnings))
    assert told == [False, False, False, False, True]


def test_once_all_agrees_one_that_comes_into_view_piece_by_piece_is_no_contradiction() -> None:
    watch = Watch()
    for agreed in (290, 300, 295, 110, 120):
        watch = watch.after(Held(seen=100, covered=100, measured=300, agreed=agreed))
    assert watch.warnings == ()
    assert watch.after(Held(seen=0, covered=0)).agreement == watch.agreement


def test_ground_in_a_mask_that_is_wider_than_the_thing_is_no_contradiction() -> None:
    """A small thing in the image of the only camera with depth: most of its mask shows the floor around it."""
    margin = Margin(GRID, 0.15)
    state = state_of(0, CENTER, radius=0.05, cameras=RIG[:1], with_depth=True)
    wider = cv2.dilate(state.moving_masks[0].astype(np.uint8), np.ones((9, 9), np.uint8)) > 0
    state = replace(state, moving_masks=(wider,))
    ball = ball_voxels(CENTER, 0.08)
    judgement = Judgement(state, margin, RigTables(margin.outer), ball, halves(margin, ball))
    assert judgement.of(ALL).agreed < 0.5 * judgement.of(ALL).measured
    nobody = judgement.of_all(lambda voxels: np.zeros(len(voxels), np.bool_))
    somebody = judgement.of_all(lambda voxels: np.ones(len(voxels), np.bool_))
    assert nobody.measured == nobody.agreed > 0
    assert somebody.measured == judgement.of(ALL).measured
