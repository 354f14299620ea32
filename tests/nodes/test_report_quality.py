"""Which cloud an image is held against: the one that follows its set, and the newest that was out by then."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from types import SimpleNamespace
from typing import cast

import numpy as np
import pytest

from twin_node.model import WindowModel
from twin_node.nodes.report.quality import (
    First,
    Image,
    Renderings,
    clouds_against_images,
    render_cloud,
    score,
    without,
)
from twin_node.nodes.spool import Spool, Tick
from twin_node.scene import PLAIN, Camera, Exposure, FrameSet, GaussianCloud, NodeStates, Tier, TwinState, View

PERIOD = 33_000_000
LATE = 50_000_000
"""From a set to its cloud, ns."""
K = np.array([[36.0, 0, 24], [0, 36, 18], [0, 0, 1]])
PROMPT, EARLY = Camera("prompt", 48, 36, K, np.eye(4)), Camera("early", 48, 36, K, np.eye(4))
EARLIER = {"prompt": 0, "early": 20_000_000}
"""By how much a camera's image is older than its set, ns."""
LIGHT = Exposure(np.full(3, 0.5, np.float32), np.zeros(3, np.float32))


def cloud(number: int) -> GaussianCloud:
    """One Gaussian that goes to the right, of a brightness that tells clouds apart."""
    one = np.ones((1, 1), np.float32)
    return GaussianCloud(
        means=np.array([[-0.3 + 0.1 * number, 0, 1]], np.float32),
        quats=one * np.array([1, 0, 0, 0], np.float32),
        scales=one * np.full(3, 0.1, np.float32),
        opacities=np.full(1, 0.95, np.float32),
        rgb=one * np.full(3, 0.3 + 0.1 * number, np.float32),
        velocities=one * np.array([3, 0, 0], np.float32),
        tiers=np.full(1, Tier.RIGID, np.uint8),
        ids=np.zeros(1, np.uint32),
        nodes=np.zeros(1, np.int32),
    )


def tick(number: int, late: int | None = LATE, is_dropped: bool = False, *, light: Exposure = PLAIN) -> Tick:
    """A set of both cameras, followed by a cloud that is out `late` ns after it."""
    stamp = 10 * PERIOD + number * PERIOD
    level = np.full((36, 48, 3), 50 + 10 * number, np.uint8)
    views = tuple(View(camera, stamp - EARLIER[camera.name], level) for camera in (PROMPT, EARLY))
    frames = FrameSet(stamp, views)
    if is_dropped:
        return Tick(frames)
    masks = (np.zeros((36, 48), np.bool_),) * 2
    state = TwinState(stamp, frames, cloud(number), NodeStates.none(), masks, (None, None), exposures=(light, light))
    return Tick(frames, state, published=None if late is None else stamp + late)


def frozen(camera: Camera) -> Image:
    """What the model was at first."""
    return np.full((36, 48, 3), 0.8, np.float32)


def against(ticks: Sequence[Tick]) -> list[Renderings]:
    """What is shown of ticks that a run has left in its spool."""
    with Spool(0, 1_000_000_000, 30.0) as spool:
        for one in ticks:
            spool.add(one)
        return list(clouds_against_images(spool, frozen))


def is_shown(rendered: Image | None, number: int | None, view: View, is_moved: bool) -> bool:
    """Whether that is the cloud of a set, as it is or moved to the view's stamp."""
    if rendered is None or number is None:
        return rendered is number
    seconds = (view.stamp - (10 + number) * PERIOD) * 1e-9 if is_moved else 0.0
    return np.array_equal(rendered, render_cloud(cloud(number), view.camera, seconds))


def test_an_image_is_held_against_the_newest_cloud_that_was_out_when_it_was_taken() -> None:
    """Clouds are out a set and a half late, and the fourth set was dropped."""
    shown = against([tick(number, is_dropped=number == 3) for number in range(6)])
    own = [number for number in (0, 1, 2, 2, 4, 5) for _ in EARLIER]
    known = [None, None, None, None, 0, None, 1, 0, 2, 1, 2, 2]
    assert len(shown) == len(known)
    for one, mine, then in zip(shown, own, known, strict=True):
        assert is_shown(one.ours, mine, one.view, is_moved=True)
        assert is_shown(one.published, then, one.view, is_moved=False)
        assert is_shown(one.moved_on, then, one.view, is_moved=True)


def test_a_late_cloud_is_worth_less_and_in_lockstep_none_is_late() -> None:
    """A cloud shows its own set exactly; the scene moves as the cloud's velocities say."""
    ticks = []
    for one in (tick(number) for number in range(8)):
        assert one.state is not None
        pictures = (render_cloud(one.state.gaussians, camera) for camera in (PROMPT, EARLY))
        views = [
            replace(view, stamp=one.stamp, rgb=(255 * picture).astype(np.uint8))
            for view, picture in zip(one.frames.views, pictures, strict=True)
        ]
        ticks.append(replace(one, frames=replace(one.frames, views=tuple(views))))
    quality = score(against(ticks))
    assert quality.psnr_moving_db is not None and quality.published_psnr_moving_db is not None
    assert quality.moved_on_psnr_moving_db is not None
    assert quality.psnr_moving_db > quality.moved_on_psnr_moving_db > quality.published_psnr_moving_db
    lockstep = score(against([replace(one, published=None) for one in ticks]))
    assert lockstep == replace(
        quality,
        published_psnr_moving_db=None,
        moved_on_psnr_moving_db=None,
        published_psnr_unchanged_db=None,
        moved_on_psnr_unchanged_db=None,
    )


def test_a_cloud_is_out_once_however_many_sets_are_looked_at_with_it() -> None:
    """The light of a set that was looked at later was not known when the cloud was out."""
    first, later = tick(0), tick(1, light=LIGHT)
    assert first.state is not None and later.state is not None
    unfollowed = replace(later.state, gaussians=first.state.gaussians, followed=first.stamp)
    shown = against([first, replace(later, state=unfollowed, published=first.published), tick(2)])
    assert is_shown(shown[4].published, 0, shown[4].view, is_moved=False)


def test_the_frozen_model_is_shown_in_the_light_of_its_camera() -> None:
    shown = against([tick(0, light=LIGHT), tick(1)])
    assert [float(one.frozen.max()) for one in shown] == pytest.approx([0.4] * 4)


def test_who_goes_through_the_images_again_keeps_what_they_are_held_against() -> None:
    firsts: dict[str, First] = {}
    once = list(clouds_against_images([tick(0), tick(1)], frozen, firsts))
    again = list(clouds_against_images([tick(3), tick(2)], frozen, firsts))
    assert {id(one.first) for one in again} == {id(one.first) for one in once}
    assert {id(one.frozen) for one in again} == {id(one.frozen) for one in once}


def test_what_lies_before_a_gap_is_neither_shown_nor_compared_with() -> None:
    after = replace(tick(2, is_dropped=True), is_after_gap=True)
    shown = against([tick(0), tick(1), after, tick(3), tick(4), tick(5)])
    sets = [one.set_stamp // PERIOD - 10 for one in shown]
    assert sets == [0, 0, 1, 1, 3, 3, 4, 4, 5, 5], "nothing is known of a set that was dropped after a gap"
    assert [one.previous is None for one in shown] == [True, True, False, False, True, True, *[False] * 4]
    assert is_shown(shown[8].published, 3, shown[8].view, is_moved=False)


def test_what_a_camera_shows_in_the_dark_is_held_against_nothing() -> None:
    """Beside a black first image all that is there would be called moving, and nothing unchanged."""
    begins = [tick(number) for number in range(3)]
    views = begins[0].frames.views
    black = replace(views[0], rgb=np.zeros_like(views[0].rgb))
    begins[0] = replace(begins[0], frames=replace(begins[0].frames, views=(black, *views[1:])))
    shown = against(begins)
    assert [one.view.camera.name for one in shown] == ["early", "prompt", "early", "prompt", "early"]
    assert np.array_equal(shown[1].first, shown[1].image) and shown[1].previous is None


class Seen:
    """A model that keeps what it is given, and has one state for all of it."""

    def __init__(self) -> None:
        self.sets: list[FrameSet] = []

    def update(self, frames: FrameSet) -> TwinState:
        self.sets.append(frames)
        state = tick(0).state
        assert state is not None
        return replace(state, frames=frames)

    def render_frozen(self, camera: Camera) -> SimpleNamespace:
        return SimpleNamespace(rgb=frozen(camera))


def test_a_model_without_a_camera_begins_when_the_others_show_something() -> None:
    sets = [tick(number).frames for number in range(4)]

    def dark(frames: FrameSet, *rows: int) -> FrameSet:
        views = [replace(v, rgb=v.rgb * 0) if row in rows else v for row, v in enumerate(frames.views)]
        return replace(frames, views=tuple(views))

    model = Seen()
    shown = list(without("early", [dark(sets[0], 0, 1), dark(sets[1], 1), *sets[2:]], cast(WindowModel, model)))
    assert [one.stamp for one in model.sets] == [one.stamp for one in sets[1:]]
    assert [one.set_stamp for one in shown] == [one.stamp for one in sets[2:]]
    assert np.array_equal(shown[1].first, shown[0].image)
