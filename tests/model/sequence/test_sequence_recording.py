"""Recordings: sets become images to learn from and images to be scored on."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from model_scenes import camera, rig, sliding
from sequence_scenes import block_recording

from twin_node.model import ModelError
from twin_node.model.sequence import ColouredPoints, Recording, Span, recording, recording_of, split
from twin_node.model.sequence.recording import nearest
from twin_node.scene import FrameSet


def test_sets_come_back_as_they_went_in() -> None:
    sets = sliding(5, rig(40, 30), still=0)
    again = recording_of("block", sets).sets()
    assert [one.stamp for one in again] == [one.stamp for one in sets]
    assert [[view.camera.name for view in one.views] for one in again] == [["cam0", "cam1", "cam2"]] * 5


def test_cameras_of_other_times_stay_together() -> None:
    skewed = [
        replace(one, views=tuple(replace(v, stamp=v.stamp + 4_000_000 * i) for i, v in enumerate(one.views)))
        for one in sliding(4, rig(40, 30), still=0)
    ]
    recording = recording_of("block", skewed)
    assert recording.steps == 4
    assert [len(one.views) for one in recording.sets()] == [3] * 4
    assert [one.stamp for one in recording.sets()] == [max(v.stamp for v in one.views) for one in skewed]


@pytest.mark.parametrize("missing", [lambda index: index % 2, lambda index: index < 3, lambda index: index in (2, 5)])
def test_sets_that_miss_a_camera_come_back_with_the_images_of_their_own_time(missing: Callable[[int], bool]) -> None:
    whole = sliding(8, rig(40, 30), still=0)
    sets = [replace(one, views=one.views[: 2 if missing(index) else 3]) for index, one in enumerate(whole)]
    again = recording_of("block", sets).sets()
    assert [one.stamp for one in again] == [one.stamp for one in sets]
    assert [[view.stamp for view in one.views] for one in again] == [[v.stamp for v in one.views] for one in sets]


def test_held_out_cameras_are_not_trained_on() -> None:
    recording = block_recording(4, ("cam1",))
    assert {view.camera.name for view in recording.train} == {"cam0", "cam2"}
    assert [view.camera.name for view in recording.held_out] == ["cam1"] * 4
    assert [one.name for one in recording.cameras] == ["cam0", "cam2"]


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e39])
@pytest.mark.parametrize("name", ["positions", "rgb"])
def test_points_that_are_none_are_refused(name: str, value: float) -> None:
    points = ColouredPoints(np.zeros((4, 3)), np.zeros((4, 3), np.float32))
    values = getattr(points, name).astype(np.float64)
    values[2, 1] = value
    with pytest.raises(ModelError, match=r"^block: expected points of finite positions and colours"):
        replace(block_recording(1), points=replace(points, **{name: values}))


def test_images_that_show_nothing_yet_are_not_learnt() -> None:
    """All cameras begin black, one of them later than the others."""
    first, second, third = sliding(3, rig(40, 30))

    def black(frames: FrameSet, count: int) -> FrameSet:
        views = frames.views
        return replace(frames, views=(*(replace(v, rgb=np.zeros_like(v.rgb)) for v in views[:count]), *views[count:]))

    recording = recording_of("block", [black(first, 3), black(second, 1), third])
    assert [(view.camera.name, view.stamp) for view in recording.train] == [
        *((view.camera.name, second.stamp) for view in second.views[1:]),
        *((view.camera.name, third.stamp) for view in third.views),
    ]
    with pytest.raises(ModelError, match=r"^block: expected sets of images that show something"):
        recording_of("block", [black(first, 3)])


def test_more_images_than_memory_holds_are_refused_while_they_are_read(monkeypatch: pytest.MonkeyPatch) -> None:
    sets = iter(sliding(9, rig(40, 30)))
    monkeypatch.setattr(recording, "MOST_BYTES", 2.5 * 3 * 40 * 30 * 3)
    with pytest.raises(ModelError, match=r"^long: expected images .* more in the first 8; .*--frames"):
        recording_of("long", sets)
    assert len(list(sets)) == 6


def test_frames_are_counted_in_sets() -> None:
    recording = recording_of("block", sliding(5, rig(40, 30)), frames=2)
    assert recording.steps == 2 and len(recording.train) == 6


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: block_recording(2, ("nobody",)), "no 'nobody'"),
        (lambda: block_recording(2, ("cam0", "cam1", "cam2")), "--hold-out"),
        (lambda: recording_of("empty", []), "empty: expected sets"),
        (lambda: Recording("empty", ()), "empty: expected images"),
    ],
)
def test_what_cannot_be_learnt_from_is_named(make: object, says: str) -> None:
    with pytest.raises(ModelError, match=says):
        make()


def test_many_cameras_are_not_all_listed() -> None:
    views = tuple(replace(view, camera=replace(view.camera, name=f"c{i}")) for i in range(12) for view in _one_view())
    with pytest.raises(ModelError, match="and 4 more"):
        split(Recording("many", views), ("nobody",))


def test_a_moving_camera_has_a_step_per_time() -> None:
    views = tuple(
        replace(view, camera=camera(f"at{i}", (1.0, 0.1 * i, 0.8), width=40, height=30), stamp=i)
        for i in range(3)
        for view in _one_view()
    )
    moving = Recording("moving", views, camera_moves=True)
    assert moving.steps == 3 and [len(one.views) for one in moving.sets()] == [1, 1, 1]


def test_a_camera_that_stands_alone_has_an_extent() -> None:
    recording = Recording("alone", _one_view())
    assert 0.5 < recording.extent < 5


def test_extent_reaches_beyond_the_farthest_camera() -> None:
    recording = block_recording(1)
    centres = np.stack([one.T_base_cam[:3, 3] for one in recording.cameras])
    farthest = np.linalg.norm(centres - centres.mean(0), axis=1).max()
    assert recording.extent == pytest.approx(1.1 * farthest)


@given(stamps=st.lists(st.integers(0, 10**12), min_size=1, unique=True), stamp=st.integers(-(10**12), 2 * 10**12))
def test_nearest_finds_the_nearest(stamps: list[int], stamp: int) -> None:
    stamps.sort()
    found = abs(stamps[nearest(stamps, stamp)] - stamp)
    assert found == min(abs(other - stamp) for other in stamps)


@given(first=st.integers(0, 2**62), length=st.integers(0, 2**61), share=st.floats(-1, 2))
def test_times_of_a_span_reach_both_ends(first: int, length: int, share: float) -> None:
    span = Span(first, first + length)
    times = span.times([first, first + length, first + round(share * length)])
    assert bool((times.abs() <= 1).all())
    if length:
        assert times[0] == -1 and times[1] == 1


def _one_view() -> tuple:
    return sliding(1, (rig(40, 30)[0],))[0].views
