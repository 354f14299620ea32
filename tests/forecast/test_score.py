"""Scores against hand-made truths."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from forecast_worlds import GRID, RIG, ball_depth, ball_voxels, state_of

from twin_node.forecast.comparison import Comparison
from twin_node.forecast.grid import encode_runs
from twin_node.forecast.score import blocked_volume, colour_mask, iou, nearest_error, projected, score_points
from twin_node.scene import HORIZONS_NS, Bool, Occupancy, OccupancyLayer, View

CENTER = np.array([0.0, 0.0, 0.4])


def layer(indices: np.ndarray, horizon: int = 0) -> OccupancyLayer:
    return OccupancyLayer(horizon, np.sort(indices).astype(np.uint32), np.full(len(indices), 255, np.uint8))


def occupancy(now: np.ndarray, later: np.ndarray, stamp: int = 0) -> Occupancy:
    layers = tuple(layer(now if horizon < HORIZONS_NS[-1] else later, horizon) for horizon in HORIZONS_NS)
    return Occupancy(stamp, stamp, GRID, layers, layer(np.zeros(0, int)), encode_runs(np.zeros(GRID.size, np.bool_)))


def test_points_inside_outside_new_and_off_the_grid() -> None:
    held, missed = GRID.centers(np.array([10, 500])), GRID.centers(np.array([900]))
    points = np.concatenate([held, missed, [[50.0, 0, 0]], [[np.nan, 0, 0]]])
    score = score_points(GRID, np.array([10, 500, 700]), points, np.array([10]))
    assert (score.found, score.of, score.new_found, score.new_of) == (2, 3, 1, 2)


def test_unknown_space_counts_as_volume() -> None:
    found = occupancy(np.array([1, 2]), np.array([1, 2]))
    unknown = np.zeros(GRID.size, np.bool_)
    unknown[2:6] = True
    blocked = Occupancy(0, 0, GRID, found.layers, found.static, encode_runs(unknown))
    assert np.isclose(blocked_volume(blocked, blocked.layers[0]), 5 * 27e-3)


def test_a_projected_ball_looks_like_the_ball() -> None:
    for cam in RIG:
        seen = np.isfinite(ball_depth(cam, CENTER, 0.2))
        assert iou(projected(cam, GRID, ball_voxels(CENTER, 0.2)), seen) > 0.8


def test_voxels_behind_or_beside_the_camera_do_not_project() -> None:
    cam = RIG[0]
    behind = GRID.indices(np.array([[0.0, 0.0, 0.4]]))
    turned = cam.T_base_cam.copy()
    turned[:3, :3] = turned[:3, :3] @ np.diag([-1.0, 1.0, -1.0])
    away = type(cam)(cam.name, cam.width, cam.height, cam.K, turned)
    assert projected(cam, GRID, behind).any()
    assert not projected(away, GRID, behind).any()


def test_distance_to_the_forecast_is_zero_inside_and_measured_outside() -> None:
    index = int(GRID.indices(CENTER[None])[0])
    center = GRID.centers(np.array([index]))
    errors = nearest_error(GRID, layer(np.array([index])), np.concatenate([center, center + np.array([0.3, 0, 0])]))
    assert np.allclose(errors, [0, 0.3])
    assert np.isinf(nearest_error(GRID, layer(np.zeros(0, int)), center)).all()


def test_points_that_were_not_seen_are_no_distance_from_a_forecast() -> None:
    """Markers go missing; what no number becomes as a whole one is a warning, and differs between processors."""
    center = GRID.centers(np.array([7]))
    with np.errstate(invalid="raise"):
        errors = nearest_error(GRID, layer(np.array([7])), np.concatenate([center, np.full((1, 3), np.nan)]))
    np.testing.assert_array_equal(errors, [0.0])


def test_colours_are_told_apart_across_the_end_of_the_hue_circle() -> None:
    rgb = np.array([[[255, 100, 20], [255, 0, 30], [30, 60, 255], [120, 110, 100]]], np.uint8)
    assert colour_mask(rgb, 8).tolist() == [[True, False, False, False]]
    assert colour_mask(rgb, 179).tolist() == [[False, True, False, False]]


class BallTruth:
    """The same voxels at every time."""

    source = "a ball"

    def __init__(self, occupied: np.ndarray | None = None) -> None:
        """`occupied` [n, 3]: all that is known to be occupied, m; None: that is not known."""
        self._occupied = occupied

    def occupied(self, stamp: int) -> np.ndarray | None:
        return self._occupied

    def points(self, stamp: int, evidence: int) -> np.ndarray | None:
        return GRID.centers(ball_voxels(CENTER))

    def volume_l(self, stamp: int) -> float | None:
        return len(ball_voxels(CENTER)) * 27e-3

    def pixels(self, view: View) -> Bool | None:
        return np.isfinite(ball_depth(view.camera, CENTER, 0.12))


def test_forecasts_are_scored_when_their_time_has_come() -> None:
    ball = ball_voxels(CENTER)
    comparison = Comparison(BallTruth(), "half")
    half = occupancy(ball[: len(ball) // 2], ball[: len(ball) // 2])
    whole = occupancy(ball, ball)
    comparison.add(state_of(0, CENTER), {"half": half, "whole": whole})
    comparison.add(state_of(150_000_000, CENTER), {})
    assert comparison.scores() == {}
    comparison.add(state_of(200_000_000, CENTER), {})
    scores = comparison.scores()
    assert scores["whole"].recall == 1.0
    assert scores["whole"].recall_new == 1.0
    assert np.isclose(scores["half"].recall or 0, 0.5, atol=0.01)
    assert scores["half"].recall_new == 0.0
    assert np.isclose(scores["whole"].inflation or 0, 1.0)
    assert scores["whole"].error_mm == 0.0
    assert (scores["half"].error_mm or 0) > 0
    assert (scores["whole"].iou or 0) > (scores["half"].iou or 1)


def test_what_was_published_as_standing_is_held_too() -> None:
    ball = ball_voxels(CENTER)
    half = occupancy(ball[: len(ball) // 2], ball[: len(ball) // 2])
    comparison = Comparison(BallTruth(), "moving")
    stands = replace(half, static=layer(ball[len(ball) // 2 :]))
    comparison.add(state_of(0, CENTER), {"moving": half, "moving and standing": stands})
    comparison.add(state_of(200_000_000, CENTER), {})
    scores = comparison.scores()
    assert scores["moving"].recall == scores["moving"].recall_held == scores["moving and standing"].recall
    assert scores["moving and standing"].recall_held == 1.0


def test_new_is_what_was_not_truly_occupied_where_the_truth_knows() -> None:
    ball = ball_voxels(CENTER)
    occupied = ball[: len(ball) // 2]
    comparison = Comparison(BallTruth(GRID.centers(occupied)), "nothing")
    nothing = occupancy(ball[:0], ball[:0])
    comparison.add(state_of(0, CENTER), {"nothing": nothing, "half": occupancy(ball, occupied)})
    comparison.add(state_of(200_000_000, CENTER), {})
    half = comparison.scores()["half"]
    assert np.isclose(half.recall or 0, 0.5, atol=0.01)
    assert half.recall_new == 0.0


class LargeThenSmall(BallTruth):
    """Each of the ball's voxels many times at first, one far from it later; notes what it is asked for."""

    def __init__(self) -> None:
        super().__init__()
        self.asked: list[tuple[int, int]] = []

    def points(self, stamp: int, evidence: int) -> np.ndarray | None:
        self.asked.append((stamp, evidence))
        return GRID.centers(np.repeat(ball_voxels(CENTER), MANY) if stamp < SECOND else np.array([0]))


SECOND = 1_000_000_000
MANY = 10


def test_a_forecast_is_asked_for_what_its_own_evidence_can_tell_now_and_later() -> None:
    ball, truth = ball_voxels(CENTER), LargeThenSmall()
    comparison = Comparison(truth, "ball")
    comparison.add(state_of(0, CENTER), {"ball": replace(occupancy(ball, ball), publish_stamp=33_000_000)})
    comparison.add(state_of(SECOND, CENTER), {})
    assert sorted(truth.asked) == [(33_000_000, 0), (233_000_000, 0)]


def test_errors_are_those_of_all_points_however_they_are_spread_over_the_forecasts() -> None:
    ball = ball_voxels(CENTER)
    comparison = Comparison(LargeThenSmall(), "ball")
    comparison.add(state_of(0, CENTER), {"ball": occupancy(ball, ball)})
    comparison.add(state_of(SECOND, CENTER), {"ball": occupancy(ball, np.array([10]), SECOND)})
    comparison.add(state_of(2 * SECOND, CENTER), {})
    far = np.linalg.norm(GRID.centers(np.array([0])) - GRID.centers(np.array([10])))
    assert np.isclose(comparison.scores()["ball"].error_mm or 0, 1e3 * far / (MANY * len(ball) + 1))


def test_views_far_from_the_forecast_time_do_not_count() -> None:
    ball = ball_voxels(CENTER)
    comparison = Comparison(BallTruth(), "ball")
    comparison.add(state_of(0, CENTER), {"ball": occupancy(ball, ball)})
    comparison.add(state_of(300_000_000, CENTER), {})
    assert comparison.scores()["ball"].iou is None


class TruthAtTimes(BallTruth):
    """Knows the volume at every other set alone."""

    def volume_l(self, stamp: int) -> float | None:
        return super().volume_l(stamp) if stamp % 400_000_000 == 0 else None


def test_inflation_compares_forecasts_for_times_at_which_the_true_volume_is_known() -> None:
    ball = ball_voxels(CENTER)
    comparison, forecast = Comparison(TruthAtTimes(), "ball"), occupancy(ball, ball)
    for stamp in range(0, 1_000_000_000, 200_000_000):
        comparison.add(state_of(stamp, CENTER), {"ball": replace(forecast, stamp=stamp, publish_stamp=stamp)})
    score = comparison.scores()["ball"]
    assert np.isclose(score.inflation or 0, 1.0)
    assert np.isclose(score.moving_volume_l or 0, len(ball) * 27e-3)
