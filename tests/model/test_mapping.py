"""What stands still is refined beside the tracking: where it is wrong, and nowhere else."""

from __future__ import annotations

import itertools
import threading
from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch
from model_scenes import block, frames, joined, rig, seen, sliding, table

from twin_node.model import (
    MapParameters,
    ModelParameters,
    SeedParameters,
    WindowModel,
)
from twin_node.model.backgrounds import Backgrounds, _drawn
from twin_node.model.gaussians import RGB, Gaussians, Newborns
from twin_node.model.mapping import Mapper
from twin_node.model.observation import Observer
from twin_node.model.plane import Plane
from twin_node.model.quality import psnr, squared_error
from twin_node.model.rays import look
from twin_node.model.stages import granted
from twin_node.model.sweep import shell_around
from twin_node.native_library import kernel_threads
from twin_node.scene import FrameSet, Tier, TwinState

QUICK = ModelParameters(seed=SeedParameters(steps=24), gaussians_per_pixel=0.5)
UNREFINED = replace(QUICK, map=MapParameters(steps=0))
CAMERAS = rig()


def lit(index: int, by: float) -> FrameSet:
    """Set `index` of the table under a lamp that lights a third of it so much more."""
    whole = table()
    under = (whole.means[0, :, 1] < -0.25)[:, None]
    return seen(index, replace(whole, rgb=torch.where(under, by * whole.rgb, whole.rgb)), CAMERAS)


def shown_db(model: WindowModel, state: TwinState) -> float:
    """PSNR of the newest set, mean over views."""
    return float(
        np.mean([psnr(squared_error(model.render(v.camera).rgb, v.rgb / 255).mean()) for v in state.frames.views])
    )


def still(rows: TwinState) -> np.ndarray:
    """What STATIC Gaussians are, [n, 14]."""
    cloud = rows.gaussians.only(rows.gaussians.tiers == Tier.STATIC)
    return np.column_stack([cloud.means, cloud.quats, cloud.scales, cloud.opacities, cloud.rgb])


def test_a_lamp_that_lights_some_of_what_stands_is_taken_up() -> None:
    gained = []
    for parameters in (UNREFINED, QUICK):
        model = WindowModel(parameters)
        for index in range(40):
            state = model.update(lit(index, 1.0 if index < 3 else 1.1))
        gained.append(shown_db(model, state))
    assert gained[1] > gained[0] + 2


@pytest.mark.parametrize(("width", "height"), [(1, 1), (1, 60), (80, 1)])
def test_images_one_pixel_across_have_no_room_for_new_gaussians(width: int, height: int) -> None:
    model = WindowModel(QUICK)
    for one in sliding(4, rig(width, height)):
        state = model.update(one)
        model.refine()
        assert len(state.gaussians.means) <= width * height * len(CAMERAS)


def test_a_scene_at_rest_is_learnt_better_and_then_stays_as_it_is_to_the_bit() -> None:
    model = WindowModel(replace(QUICK, seed=SeedParameters(steps=5), map=MapParameters(tries=3)))
    states = [model.update(frames(0, -0.15, CAMERAS))]
    shown = [shown_db(model, states[0])]
    for index in range(1, 80):
        states.append(model.update(frames(index, -0.15, CAMERAS)))
    shown.append(shown_db(model, states[-1]))
    assert shown[-1] > shown[0] + 0.5
    assert np.array_equal(still(states[70]), still(states[-1]))


def test_a_camera_that_is_in_every_second_set_has_its_turn_too() -> None:
    """It never came to it: what it sees stayed as the first set had left it."""
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=8), gaussians_per_pixel=0.5))
    shown = []
    for index, one in enumerate(sliding(40, rig()[:2], depth=True, still=40)):
        model.update(one if index % 2 == 0 else replace(one, views=one.views[:1]))
        model.refine()
        slow = one.views[1]
        shown.append(psnr(squared_error(model.render(slow.camera).rgb, slow.rgb / 255).mean()))
    assert shown[-1] > shown[0] + 2


def test_edges_of_what_stands_look_no_worse_for_depth_that_is_wrong_beside_them() -> None:
    """As a stereo camera measures: what is near is a pixel wider than it is, and the image is noisy."""
    rng, cameras = np.random.default_rng(0), rig(120, 90)
    scene, model = joined(joined(table(), block(0.1)), block(-0.4, 0.3)), WindowModel()
    for index in range(46):
        clean = seen(index, scene, cameras, depth=True)
        views = []
        for view in clean.views:
            assert view.depth is not None
            rgb = (view.rgb + rng.normal(0, 2, view.rgb.shape)).clip(0, 255).astype(np.uint8)
            views.append(replace(view, rgb=rgb, depth=cv2.erode(view.depth, np.ones((3, 3), np.uint8))))
        model.update(replace(clean, views=tuple(views)))
    for view in clean.views:
        ours, frozen = (
            psnr(squared_error(image, view.rgb / 255).mean())
            for image in (model.render(view.camera).rgb, model.render_frozen(view.camera).rgb)
        )
        assert ours > frozen


def test_refining_at_once_or_with_the_next_set_is_the_same() -> None:
    clouds = []
    for at_once in (False, True):
        model = WindowModel(QUICK)
        for one in sliding(14, CAMERAS):
            state = model.update(one)
            if at_once:
                model.refine()
                model.refine()
        clouds.append(state.gaussians)
    assert clouds[0].means.tobytes() == clouds[1].means.tobytes()
    assert clouds[0].rgb.tobytes() == clouds[1].rgb.tobytes()


def test_ground_far_from_what_moves_keeps_its_place() -> None:
    model = WindowModel(QUICK)
    before = still(model.update(sliding(1, CAMERAS)[0]))
    for one in sliding(24, CAMERAS):
        state = model.update(replace(one, stamp=one.stamp + 1, views=one.views))
    far = before[before[:, 1] < -0.4]
    after = still(state)
    moved = np.array([np.abs(after[:, :3] - row[:3]).sum(1).min() for row in far])
    assert np.percentile(moved, 90) < 0.001 and moved.max() < 0.01


@pytest.mark.parametrize("steps", [1, 2, 3])
def test_a_step_is_let_be_once_while_all_its_views_are_looked_through(steps: int) -> None:
    whole, nothing = table(), [np.zeros((60, 80), bool)] * len(CAMERAS)
    count = whole.means.shape[1]
    store = Gaussians(count, torch.device("cpu"))
    nobody = torch.full((count,), -1, dtype=torch.int64)
    parts = (whole.means[0], whole.quats[0], whole.scales, whole.opacities, 0.5 * whole.rgb)
    store.spawn(Newborns(*parts, Tier.STATIC, nobody), 0)
    backgrounds = Backgrounds(Plane(np.array([0.0, 0.0, 1.0]), 0.0), shell_around(CAMERAS, 2.5))
    mapper, observer = Mapper(MapParameters(calm_s=0.05), store, backgrounds, count), Observer(60.0)
    slices = []
    for index in range(2 * len(CAMERAS)):
        now, known = frames(index, None, CAMERAS), backgrounds.of(store, CAMERAS)
        observed = observer.observe(now, nothing, [None] * len(CAMERAS), known, 0.033)
        slices.append(len(list(mapper.refine(observed, now.stamp, steps))))
    assert slices[0] == 0 and slices[-1] == steps


def test_a_camera_is_drawn_meanwhile_as_gaussians_were_when_that_began() -> None:
    whole = table()
    store = Gaussians(whole.means.shape[1], torch.device("cpu"))
    nobody = torch.full((store.capacity,), -1, dtype=torch.int64)
    born = Newborns(whole.means[0], whole.quats[0], whole.scales, whole.opacities, whole.rgb, Tier.STATIC, nobody)
    store.spawn(born, 0)
    backgrounds = Backgrounds(Plane(np.array([0.0, 0.0, 1.0]), 0.0), shell_around(CAMERAS, 2.5))
    before = backgrounds.of(store, CAMERAS)
    drawn = []
    for green in (0.5, 1.0):
        store.values[:, RGB] = torch.tensor([0.0, green, 0.0])
        backgrounds.repaint()
        list(backgrounds.keep_up(store))
        store.values[:, RGB] = 0
        drawn.append(backgrounds.of(store, CAMERAS))
    for at, later in enumerate(drawn):
        for index, (old, new) in enumerate(zip(before, later, strict=True)):
            if index <= at:
                assert new.rgb[..., 0].max() == 0 and new.rgb[..., 1].max() == pytest.approx(0.5 + 0.5 * index, 0.02)
            else:
                assert np.array_equal(old.rgb, new.rgb)
            np.testing.assert_allclose(new.alpha, old.alpha, atol=1e-6)


@pytest.mark.parametrize("every", [1, 4, 11])
def test_shares_that_are_broken_off_teach_all_the_same(every: int) -> None:
    """Every so many of the questions whether to go on are answered with no: every one where a set always waits,
    one of four where each set is broken off somewhere."""
    shown = []
    for steps in (0, MapParameters().steps):
        model, answers, whole = WindowModel(replace(QUICK, map=MapParameters(steps=steps))), itertools.count(1), []
        for index in range(60):
            state = model.update(lit(index, 1.0 if index < 3 else 1.1))
            whole.append(model.refine(lambda answers=answers: next(answers) % every != 0))
        assert not all(whole[1:]) and (every < 11 or any(whole[1:]))
        shown.append(shown_db(model, state))
    assert shown[1] > shown[0] + 1


@pytest.mark.parametrize(("waits", "births", "begun"), [(False, 8, 8), (True, 7, 4)])
def test_births_are_put_off_once_where_a_set_waits_and_learning_every_other_time(
    waits: bool, births: int, begun: int
) -> None:
    model, stages = WindowModel(QUICK), []
    model.on_stage = stages.append
    for one in sliding(9, CAMERAS):
        model.update(one)
        model.refine(lambda: not waits)
    assert stages.count("bear") == births
    assert stages.count("begin") == begun


@pytest.mark.parametrize(("slices", "done"), [(1, []), (2, ["regroup"]), (4, ["regroup", "bear"])])
def test_a_set_that_comes_meanwhile_puts_off_what_is_left(slices: int, done: list[str]) -> None:
    model, stages = WindowModel(QUICK), []
    for one in sliding(8, CAMERAS):
        model.update(one)
        model.refine()
    model.update(sliding(9, CAMERAS)[-1])
    model.on_stage = stages.append
    model.refine(granted(slices))
    assert [stage for stage in stages if stage in ("regroup", "bear")] == done


def test_who_does_not_wait_is_shown_what_was_drawn_later(monkeypatch: pytest.MonkeyPatch) -> None:
    """The background of a set that may be late is the one before, until the thread that draws it is done."""
    store, backgrounds = half_a_table(0)
    with kernel_threads(2):
        before = backgrounds.of(store, CAMERAS)
        gate = threading.Event()
        monkeypatch.setattr(
            "twin_node.model.backgrounds._drawn", lambda *given: _drawn(*given) if gate.wait() else None
        )
        store.values[:, RGB] = 0
        backgrounds.repaint()
        list(backgrounds.keep_up(store))
        meanwhile = backgrounds.of(store, CAMERAS, waits=False)
        gate.set()
        list(backgrounds.keep_up(store))
        after = backgrounds.of(store, CAMERAS)
    assert np.array_equal(meanwhile[0].rgb, before[0].rgb)
    assert after[0].rgb.max() == 0 < before[0].rgb.max()


def test_what_is_still_being_drawn_does_not_outlive_what_is_drawn_anew(monkeypatch: pytest.MonkeyPatch) -> None:
    store, backgrounds = half_a_table(0)
    with kernel_threads(2):
        backgrounds.of(store, CAMERAS)
        gate = threading.Event()
        with monkeypatch.context() as held:
            held.setattr("twin_node.model.backgrounds._drawn", lambda *given: _drawn(*given) if gate.wait() else None)
            backgrounds.repaint()
            list(backgrounds.keep_up(store))
        store.values[:, RGB] = 0
        backgrounds.renew()
        anew = backgrounds.of(store, CAMERAS, waits=False)
        gate.set()
        later = backgrounds.of(store, CAMERAS)
    assert anew[0].rgb.max() == 0 == later[0].rgb.max()


def test_a_camera_that_leaves_before_it_is_drawn_anew_is_not_drawn() -> None:
    store, backgrounds = half_a_table(0)
    backgrounds.of(store, CAMERAS)
    backgrounds.repaint()
    backgrounds.renew()
    backgrounds.of(store, CAMERAS[:1])
    while backgrounds.are_behind:
        list(backgrounds.keep_up(store))
    assert [one.camera.name for one in backgrounds.of(store, CAMERAS[:1])] == [CAMERAS[0].name]


def half_a_table(arm: int) -> tuple[Gaussians, Backgrounds]:
    """The table without the part beyond x = 0.3 m, and `arm` Gaussians of an arm out of sight; with room for twice."""
    whole = table()
    kept = whole.means[0, :, 0] < 0.3
    parts = [of[kept] for of in (whole.means[0], whole.quats[0], whole.scales, whole.opacities, whole.rgb)]
    count = int(kept.sum())
    store = Gaussians(2 * count, torch.device("cpu"))
    for some, tier in ((count, Tier.STATIC), (arm, Tier.ROBOT)):
        nobody = torch.full((some,), -1, dtype=torch.int64)
        store.spawn(Newborns(*(of[:some] for of in parts), tier, nobody), 0)
    return store, Backgrounds(Plane(np.array([0.0, 0.0, 1.0]), 0.0), shell_around(CAMERAS, 2.5))


def filled(store: Gaussians, backgrounds: Backgrounds, most_static: int) -> list[float]:
    """What the images miss, set by set, of what a mapper makes of the whole table."""
    mapper, observer = Mapper(MapParameters(), store, backgrounds, most_static), Observer(60.0)
    nothing = [np.zeros((60, 80), bool)] * len(CAMERAS)
    errors = []
    for index in range(60):
        now = frames(index, None, CAMERAS)
        dark = [np.clip(known.rgb * 255, 0, 255).astype(np.uint8) for known in backgrounds.of(store, CAMERAS)]
        if index == 0:
            now = replace(now, views=tuple(replace(v, rgb=rgb) for v, rgb in zip(now.views, dark, strict=True)))
        observed = observer.observe(now, nothing, [None] * len(CAMERAS), backgrounds.of(store, CAMERAS), 0.033)
        errors.append(float(np.mean([np.abs(one.rgb - one.background.rgb).mean() for one in observed])))
        list(mapper.refine(observed, now.stamp, 2))
        list(backgrounds.keep_up(store))
    return errors


def test_what_steps_cannot_show_is_given_new_gaussians() -> None:
    store, backgrounds = half_a_table(0)
    count = len(store)
    errors = filled(store, backgrounds, store.capacity)
    assert len(store) > count
    assert errors[-1] < 0.5 * errors[1]


def test_in_images_of_odd_sizes_new_gaussians_have_the_colours_of_their_own_blocks() -> None:
    """Blocks were stretched over the whole image: of the last one three quarters were not what it shows."""
    (store, backgrounds), camera = half_a_table(0), rig(81, 61)[0]
    mapper, observer = Mapper(MapParameters(patience_s=0.0), store, backgrounds, store.capacity), Observer(60.0)
    before, still, greenest = frames(0, None, [camera]), [np.zeros((61, 81), bool)], torch.zeros(3)
    for index in range(8):
        (background,) = backgrounds.of(store, [camera])
        rgb = np.clip(background.rgb * 255, 0, 255).astype(np.uint8)
        if index > 0:
            rgb[58:60, 78:80] = 0, 255, 0
        stamp = before.stamp + index * 33_000_000
        now = replace(before, stamp=stamp, views=(replace(before.views[0], stamp=stamp, rgb=rgb),))
        list(mapper.refine(observer.observe(now, still, [None], [background], 0.033), stamp, 1))
        for colour in store.values[store.alive & (store.births == stamp), RGB]:
            greenest = torch.where(colour[1] > greenest[1], colour, greenest)
    np.testing.assert_allclose(greenest, [0, 1, 0], atol=1e-6)


def test_what_stands_and_the_arm_together_leave_room_for_what_moves() -> None:
    store, backgrounds = half_a_table(60)
    most = len(store) + 5
    filled(store, backgrounds, most)
    assert len(store) == most


def test_a_mask_says_the_same_of_points_by_one_index_as_by_two() -> None:
    camera, rng = CAMERAS[0], np.random.default_rng(0)
    mask = rng.random((camera.height, camera.width)) < 0.5
    points = look(camera, rng.uniform(-0.6, 0.6, (500, 3)))
    assert np.array_equal(points.within(mask), mask[points.rows, points.columns])
    assert np.array_equal(points.within(mask[::-1]), mask[::-1][points.rows, points.columns])


def test_one_thread_and_two_learn_the_same() -> None:
    clouds = []
    for threads in (1, 2):
        model = WindowModel(ModelParameters(seed=SeedParameters(steps=20)))
        with kernel_threads(threads):
            for one in sliding(12, rig()):
                state = model.update(one)
        clouds.append(state.gaussians)
    assert clouds[0].means.tobytes() == clouds[1].means.tobytes()
    assert clouds[0].rgb.tobytes() == clouds[1].rgb.tobytes()
