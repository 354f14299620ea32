"""A camera that has few landmarks: what covers it is not taken for them, and it is still told when it has moved."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import cv2
import numpy as np
import pytest
from test_landmarks import after, scene

from twin_node.rig.drift import DriftParameters, DriftWatch
from twin_node.rig.drift_report import Drift, Verdict
from twin_node.scene import Camera, FrameSet, UInt8, View

WIDTH, HEIGHT = 160, 120
CAMERA = Camera("left", WIDTH, HEIGHT, np.array([[150.0, 0, 80.5], [0, 150.0, 60.5], [0, 0, 1]]), np.eye(4))
STEP_NS = 200_000_000


def wall(*squares: tuple[int, int]) -> UInt8:
    """Squares on grey, the left upper corner of each."""
    image = np.full((HEIGHT, WIDTH, 3), 110, np.uint8)
    for x, y in squares:
        image[y : y + 10, x : x + 10] = 220
    return image


def plain_wall() -> UInt8:
    """Six squares: 24 corners, so few that others would be taken where there are."""
    return wall((20, 20), (80, 30), (130, 15), (30, 80), (85, 90), (125, 70))


def pattern() -> UInt8:
    """An image full of corners."""
    coarse = np.random.default_rng(0).integers(0, 255, (30, 40, 3), dtype=np.uint8)
    return np.asarray(cv2.resize(coarse, (WIDTH, HEIGHT), interpolation=cv2.INTER_CUBIC), np.uint8)


def watched(images: Sequence[UInt8]) -> list[Drift]:
    """What a watch says of one camera's images, which come at the pace of its checks, with a little noise."""
    rng, watch, said = np.random.default_rng(1), DriftWatch(DriftParameters(lost_s=1.0)), []
    for number, image in enumerate(images):
        noisy = np.clip(image + rng.normal(0, 0.3, image.shape), 0, 255).astype(np.uint8)
        stamp = number * STEP_NS
        said.append(watch.update(FrameSet(stamp, (View(CAMERA, stamp, noisy),))).drifts[0])
    return said


def test_a_camera_of_few_landmarks_that_is_turned_away_is_lost() -> None:
    """What it saw then became its landmarks, and it was said to stand where it was calibrated."""
    said = watched([plain_wall()] * 8 + [pattern()] * 12)
    assert {drift.verdict for drift in said[:8]} == {Verdict.STEADY}
    assert said[-1].verdict is Verdict.LOST


def test_a_camera_of_few_landmarks_is_steady_again_after_something_has_passed_before_it() -> None:
    """What covered it became its landmarks: when that was gone, it was lost for ever."""
    said = watched([plain_wall()] * 8 + [pattern()] * 4 + [plain_wall()] * 12)
    assert said[-1].verdict is Verdict.STEADY
    assert not any(drift.verdict is Verdict.LOST for drift in said)


def test_landmarks_that_have_become_few_are_made_anew_of_a_camera_that_stands() -> None:
    poster = plain_wall()
    poster[10:65, 97:121] = pattern()[10:65, 97:121]
    said = watched([plain_wall()] * 4 + [poster] * 4)
    assert {drift.verdict for drift in said} == {Verdict.STEADY}
    assert said[-1].features > 40


def test_landmarks_that_are_too_few_for_a_verdict_are_replaced_by_enough() -> None:
    """Of five things two were put elsewhere: what stood was too little from then on, and the camera lost for ever."""
    before = wall((20, 20), (85, 40), (130, 15), (5, 80), (24, 100))
    after = wall((20, 20), (85, 40), (130, 15), (9, 84), (20, 96))
    said = watched([before] * 4 + [after] * 16)
    assert {drift.verdict for drift in said} == {Verdict.STEADY}
    assert said[-1].features > 15


def test_depth_that_begins_later_is_depth_that_the_camera_measures() -> None:
    watch, depth = DriftWatch(), np.ones((HEIGHT, WIDTH), np.float32)
    said = []
    for number, measured in enumerate([None, None, depth, None]):
        view = View(CAMERA, number * STEP_NS, plain_wall(), measured)
        said.append(watch.update(FrameSet(view.stamp, (view,))).drifts[0].measures_depth)
    assert said == [False, False, True, True]


def test_a_camera_is_looked_at_once_in_a_period() -> None:
    watch, said = DriftWatch(DriftParameters(period_ms=200.0, confirm=1)), []
    moved = np.roll(plain_wall(), 4, axis=1)
    for milliseconds, image in [
        (0, plain_wall()),
        (199, moved),
        (200, moved),
        (399, plain_wall()),
        (400, plain_wall()),
    ]:
        stamp = milliseconds * 1_000_000
        said.append(watch.update(FrameSet(stamp, (View(CAMERA, stamp, image),))).drifts[0].verdict)
    assert said == [Verdict.STEADY, Verdict.STEADY, Verdict.BUMPED, Verdict.BUMPED, Verdict.STEADY]


def of_each(images: Sequence[Sequence[UInt8]], parameters: DriftParameters | None = None) -> list[list[Verdict]]:
    """What a watch says of cameras that see full patterns, by set and camera."""
    rng, watch, said = np.random.default_rng(2), DriftWatch(parameters), []
    for number, of_set in enumerate(images):
        stamp, views = number * STEP_NS, []
        for i, image in enumerate(of_set):
            noisy = np.clip(image + rng.normal(0, 1, image.shape), 0, 255).astype(np.uint8)
            views.append(View(replace(CAMERA, name=f"cam{i}"), stamp, noisy))
        said.append(list(watch.update(FrameSet(stamp, tuple(views))).verdicts))
    return said


@pytest.mark.parametrize("shown", [scene(1), after(np.radians([0.0, 20.0, 0.0]), scene())], ids=["other", "turned"])
def test_a_camera_that_is_turned_away_to_something_as_rich_is_lost(shown: UInt8) -> None:
    """One landmark in six was found in it by chance: it was only said to see too little, and its images used."""
    said = of_each([[scene()]] * 5 + [[shown]] * 20)
    assert said[-1] == [Verdict.LOST]
    assert Verdict.BUMPED not in {verdict for verdicts in said for verdict in verdicts}


def test_cameras_of_rich_scenes_that_change_places_are_told_at_once() -> None:
    a, b, c = scene(), scene(1), scene(2)
    said = of_each([[a, b, c]] * 5 + [[b, a, c]] * 3, DriftParameters(lost_s=60.0))
    assert said[-1] == [Verdict.LOST, Verdict.LOST, Verdict.STEADY]
