"""The visual hull of what moves, as a left-out camera would see it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin_node.bench.visual_hull import HullTally, paint_hull
from twin_node.geometry import looking_at, project
from twin_node.nodes.report.quality import Renderings, unit
from twin_node.scene import Camera, FrameSet, GaussianCloud, NodeStates, TwinState, View

RADIUS = 0.25
COLOURS = ((200, 40, 40), (40, 200, 40), (40, 40, 200))


def camera(name: str, degrees: float) -> Camera:
    """One of a ring of cameras that look at the origin from 2 m."""
    angle = np.radians(degrees)
    eye = 2 * np.array([np.cos(angle), np.sin(angle), 0.0])
    K = np.array([[60.0, 0, 40], [0, 60.0, 30], [0, 0, 1]])
    return Camera(name, 80, 60, K, looking_at(eye, np.zeros(3)))


def disc(one: Camera) -> np.ndarray:
    """[H, W] where a camera sees a ball of `RADIUS` about the origin."""
    uv = project(one.K, one.viewmat, np.zeros((1, 3)))[0, :2]
    v, u = np.mgrid[:60, :80] + 0.5
    return np.hypot(u - uv[0], v - uv[1]) < 60 * RADIUS / np.sqrt(4 - RADIUS**2)


def painted(one: Camera, rgb: tuple[int, int, int], moving: np.ndarray) -> View:
    """A grey view with the ball in a colour."""
    image = np.full((60, 80, 3), 100, np.uint8)
    image[moving] = rgb
    return View(one, 1, image)


def state() -> TwinState:
    """A ball that three cameras see, each in another colour."""
    cameras = [camera(f"cam{i}", degrees) for i, degrees in enumerate((0, 90, 200))]
    masks = tuple(disc(one) for one in cameras)
    views = tuple(painted(one, rgb, mask) for one, rgb, mask in zip(cameras, COLOURS, masks, strict=True))
    around = np.array([[3.0, 0, 0], [-3.0, 0, 0], [0, 3.0, 0], [0, -3.0, 0]], np.float32)
    fours = np.ones((4, 3), np.float32)
    quats = np.ones((4, 4), np.float32)
    ids = np.arange(4, dtype=np.uint32)
    cloud = GaussianCloud(
        around, quats, fours, fours[:, 0], fours, 0 * fours, np.zeros(4, np.uint8), ids, np.full(4, -1, np.int32)
    )
    return TwinState(1, FrameSet(1, views), cloud, NodeStates.none(), masks, (None,) * 3)


@pytest.mark.parametrize(("degrees", "nearest"), [(20, 0), (100, 1), (215, 2)])
def test_the_hull_lies_where_the_thing_is_and_has_the_colour_of_the_nearest_view(degrees: float, nearest: int) -> None:
    hidden = camera("hidden", degrees)
    picture = np.zeros((60, 80, 3), np.float32)
    paint_hull(picture, hidden, np.ones((60, 80), bool), state())
    ball, hit = disc(hidden), picture.max(-1) > 0
    assert hit[ball].mean() > 0.98
    assert hit.sum() < 1.8 * ball.sum()  # three silhouettes leave edges over
    np.testing.assert_allclose(picture[30, 40], np.array(COLOURS[nearest]) / 255, atol=0.01)


@pytest.mark.parametrize("by", ["no image", "the arm"])
def test_who_cannot_tell_of_a_place_neither_denies_nor_colours_it(by: str) -> None:
    """One camera more, beside the hidden one, that has no image yet, or before which the arm stands."""
    hidden, known = camera("hidden", 20), state()
    more, covered = camera("more", 25), np.ones((60, 80), bool)
    view = painted(more, (255, 255, 255), covered)
    view = replace(view, valid=~covered) if by == "no image" else view
    with_it = replace(
        known,
        frames=FrameSet(1, (*known.frames.views, view)),
        moving_masks=(*known.moving_masks, ~covered),
        robot_masks=(*known.robot_masks, covered if by == "the arm" else None),
    )
    pictures = [np.zeros((60, 80, 3), np.float32) for _ in range(2)]
    for picture, one in zip(pictures, (known, with_it), strict=True):
        paint_hull(picture, hidden, covered, one)
    assert pictures[0].any()
    np.testing.assert_array_equal(*pictures)


def test_ours_is_scored_beside_the_hull_on_what_moves() -> None:
    hidden, now = camera("hidden", 20), state()
    ball = disc(hidden)
    first, image = painted(hidden, (100, 100, 100), ball), painted(hidden, COLOURS[0], ball)
    tally = HullTally()
    for view in (first, image):
        frozen = unit(first)
        ours = unit(view) + np.float32(0.1)
        list(tally.watch([Renderings(view.stamp, view, None, None, unit(view), unit(first), ours, frozen, None, now)]))
    assert tally.score.ours == pytest.approx(20.0, abs=0.1)
    assert tally.score.visual_hull is not None and tally.score.visual_hull > 21
    assert tally.score.gain_db == pytest.approx(tally.score.ours - tally.score.visual_hull)
