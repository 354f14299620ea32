"""A bumped camera is named within a second of log time, and nothing else is."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from twin_node.cell import CellSource, load_scenario
from twin_node.rig.drift import DriftParameters, DriftWatch
from twin_node.scene import FrameSet, View

BUMPED_AT_S = 0.6
"""When the edited recordings are bumped, s after their start."""


@pytest.fixture(scope="module")
def recording() -> tuple[FrameSet, ...]:
    """Two seconds of the demo's cell, in which a person, boxes and the arm move."""
    return tuple(CellSource(replace(load_scenario("demo"), duration_s=2.0)))


def bumped(view: View, axis: tuple[float, float, float], degrees: float) -> View:
    """The view of a camera that was turned about its own centre."""
    K = view.camera.K.copy()
    K[:2, 2] -= 0.5
    R = Rotation.from_rotvec(np.radians(degrees) * np.array(axis)).as_matrix()
    size = (view.camera.width, view.camera.height)
    turned = cv2.warpPerspective(view.rgb, K @ R @ np.linalg.inv(K), size, borderMode=cv2.BORDER_REPLICATE)
    return replace(view, rgb=np.asarray(turned, np.uint8))


def edited(
    recording: tuple[FrameSet, ...], camera: int, axis: tuple[float, float, float], degrees: float, until_s: float = 9.0
) -> Iterator[FrameSet]:
    """The recording with one camera turned from `BUMPED_AT_S` on."""
    for frames in recording:
        t = (frames.stamp - recording[0].stamp) / 1e9
        views = list(frames.views)
        if BUMPED_AT_S < t < until_s:
            views[camera] = bumped(views[camera], axis, degrees)
        yield replace(frames, views=tuple(views))


@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)])
def test_a_camera_turned_by_a_degree_is_named_within_a_second(
    recording: tuple[FrameSet, ...], axis: tuple[float, float, float]
) -> None:
    watch, named = DriftWatch(), {}
    for frames in edited(recording, 1, axis, 1.0):
        for name in watch.update(frames):
            named.setdefault(name, (frames.stamp - recording[0].stamp) / 1e9 - BUMPED_AT_S)
    assert set(named) == {recording[0].views[1].camera.name}
    assert 0 < min(named.values()) <= 1.0


def test_what_moves_before_still_cameras_bumps_none(recording: tuple[FrameSet, ...]) -> None:
    watch = DriftWatch()
    assert all(watch.update(frames) == () for frames in recording)
    assert all(drift.features >= DriftParameters().least_features for drift in watch.drifts)
    assert max(drift.angle_deg for drift in watch.drifts) < 0.1


def test_the_turn_is_measured(recording: tuple[FrameSet, ...]) -> None:
    watch = DriftWatch()
    for frames in edited(recording, 0, (0.0, 1.0, 0.0), 2.0):
        watch.update(frames)
    assert watch.drifts[0].angle_deg == pytest.approx(2.0, abs=0.35)  # pixels off the axis move a little more


def test_a_camera_put_back_is_cleared(recording: tuple[FrameSet, ...]) -> None:
    watch = DriftWatch()
    seen = [watch.update(frames) for frames in edited(recording, 1, (1.0, 0.0, 0.0), 1.0, until_s=1.3)]
    assert any(seen)
    assert seen[-1] == ()


def test_a_jump_of_the_exposure_is_no_bump(recording: tuple[FrameSet, ...]) -> None:
    watch = DriftWatch()
    for i, frames in enumerate(recording):
        gain = 0.6 if i > 20 else 1.0
        dimmed = [replace(view, rgb=(view.rgb * gain).astype(np.uint8)) for view in frames.views]
        assert watch.update(replace(frames, views=tuple(dimmed))) == ()


def test_a_covered_lens_gives_no_verdict(recording: tuple[FrameSet, ...]) -> None:
    watch = DriftWatch()
    for i, frames in enumerate(recording[:30]):
        first = frames.views[0]
        covered = replace(first, rgb=np.zeros_like(first.rgb)) if i > 10 else first
        assert watch.update(replace(frames, views=(covered, *frames.views[1:]))) == ()
    assert watch.drifts[0].features == 0


def test_a_camera_turned_so_far_that_nothing_is_found_again_is_named(recording: tuple[FrameSet, ...]) -> None:
    watch = DriftWatch()
    seen = [watch.update(frames) for frames in edited(recording, 1, (0.0, 1.0, 0.0), 30.0)]
    assert seen[-1] == (recording[0].views[1].camera.name,)


def test_after_a_reset_where_it_stands_is_where_it_belongs(recording: tuple[FrameSet, ...]) -> None:
    watch = DriftWatch()
    for frames in edited(recording, 1, (1.0, 0.0, 0.0), 1.0):
        watch.update(frames)
    watch.reset()
    for frames in list(edited(recording, 1, (1.0, 0.0, 0.0), 1.0))[40:]:
        assert watch.update(frames) == ()
