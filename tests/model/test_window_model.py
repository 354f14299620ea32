"""The window model on a scene whose Gaussians and motion are known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from model_scenes import BLOCK_SPEED, block, frames, joined, rig, seen, sliding, table

from twin_node.model import BirthParameters, ModelError, ModelParameters, SeedParameters, WindowModel
from twin_node.model.quality import moving_pixels, psnr, squared_error
from twin_node.scene import Tier, TwinState

QUICK = ModelParameters(seed=SeedParameters(steps=24), gaussians_per_pixel=0.5)
CAMERAS = rig()


@pytest.fixture(scope="module")
def followed() -> tuple[WindowModel, list[TwinState]]:
    """A model that has followed the sliding block with depth, and its states."""
    model = WindowModel(QUICK)
    return model, [model.update(one) for one in sliding(22, CAMERAS, depth=True)]


def gain(model: WindowModel, state: TwinState) -> float:
    """dB on moving pixels over the frozen first set, mean over views."""
    gains = []
    first = frames(0, -0.15, CAMERAS)
    for view, start in zip(state.frames.views, first.views, strict=True):
        image = view.rgb / 255
        moving = moving_pixels(image, start.rgb / 255)
        ours = squared_error(model.render(view.camera).rgb, image)[moving].mean()
        frozen = squared_error(model.render_frozen(view.camera).rgb, image)[moving].mean()
        gains.append(psnr(ours) - psnr(frozen))
    return float(np.mean(gains))


def test_the_first_set_is_explained_whole() -> None:
    model = WindowModel(QUICK)
    state = model.update(frames(0, -0.15, CAMERAS))
    for view in state.frames.views:
        assert psnr(squared_error(model.render(view.camera).rgb, view.rgb / 255).mean()) > 22
    assert set(state.gaussians.tiers) == {Tier.STATIC}
    assert not state.gaussians.velocities.any()


def test_what_moves_is_followed_and_beats_the_frozen_first_set(followed: tuple[WindowModel, list[TwinState]]) -> None:
    model, states = followed
    assert gain(model, states[-1]) > 6
    assert model.tier_counts[Tier.RIGID] > 20


def test_what_moves_in_the_second_set_boards_in_it() -> None:
    model = WindowModel(QUICK)
    model.update(frames(0, -0.15, CAMERAS, depth=True))
    state = model.update(frames(1, -0.08, CAMERAS, depth=True))
    assert (state.gaussians.tiers == Tier.RIGID).sum() > 10
    assert len(state.nodes.ids)


def test_nodes_carry_the_speed_of_the_block(followed: tuple[WindowModel, list[TwinState]]) -> None:
    _, states = followed
    nodes = states[-1].nodes
    members = np.bincount(states[-1].gaussians.nodes + 1, minlength=len(nodes.ids) + 1)[1:]
    velocity = (nodes.velocities * members[:, None]).sum(0) / members.sum()
    assert velocity[0] == pytest.approx(BLOCK_SPEED, rel=0.4)
    assert np.abs(velocity[1:]).max() < 0.1


def test_unchanged_pixels_do_not_smear(followed: tuple[WindowModel, list[TwinState]]) -> None:
    model, states = followed
    first = frames(0, -0.15, CAMERAS)
    for view, start in zip(states[-1].frames.views, first.views, strict=True):
        still = ~moving_pixels(view.rgb / 255, start.rgb / 255)
        ours = squared_error(model.render(view.camera).rgb, view.rgb / 255)[still].mean()
        frozen = squared_error(model.render_frozen(view.camera).rgb, view.rgb / 255)[still].mean()
        assert psnr(ours) > psnr(frozen) - 1.5


def test_colour_alone_will_do() -> None:
    model = WindowModel(QUICK)
    states = [model.update(one) for one in sliding(14, CAMERAS)]
    assert gain(model, states[-1]) > 3


def test_a_still_scene_has_no_moving_gaussians() -> None:
    model = WindowModel(QUICK)
    states = [model.update(frames(i, -0.15, CAMERAS, depth=True)) for i in range(5)]
    assert (states[-1].gaussians.tiers == Tier.STATIC).all()
    assert np.array_equal(states[-1].gaussians.means, states[0].gaussians.means)


def test_equal_inputs_give_equal_bytes() -> None:
    """Whatever random numbers torch is at, which are the caller's own: none are drawn, and none drawn anew."""
    sets = sliding(7, CAMERAS, depth=True)
    clouds = []
    for of_caller in range(2):
        torch.manual_seed(of_caller)
        before = torch.get_rng_state()
        model = WindowModel(QUICK, seed=1)
        clouds.append([model.update(one) for one in sets][-1].gaussians)
        assert torch.equal(torch.get_rng_state(), before)
    for name, values in vars(clouds[0]).items():
        assert values.tobytes() == getattr(clouds[1], name).tobytes(), name


def test_looked_at_and_followed_is_brought_up_to_date() -> None:
    whole, apart = WindowModel(QUICK), WindowModel(QUICK)
    for one in sliding(6, CAMERAS, depth=True):
        expected = whole.update(one)
        seen = apart.look(one)
        before = seen.gaussians
        found = apart.follow(seen)
        for a, b in zip(expected.moving_masks, seen.moving_masks, strict=True):
            assert np.array_equal(a, b)
        for name, values in vars(expected.gaussians).items():
            assert np.array_equal(values, getattr(found.gaussians, name)), name
    assert not np.array_equal(before.means, found.gaussians.means)


def test_a_set_that_is_only_looked_at_shows_the_model_of_the_set_before() -> None:
    model, sets = WindowModel(QUICK), list(sliding(6, CAMERAS, depth=True))
    assert model.update(sets[0]).model_stamp == sets[0].stamp
    for one in sets[1:4]:
        last = model.update(one)
    seen = model.look(sets[4])
    assert (seen.stamp, seen.model_stamp) == (sets[4].stamp, sets[3].stamp)
    assert seen.gaussians is last.gaussians
    seen = model.look(sets[5])
    assert (seen.stamp, seen.model_stamp) == (sets[5].stamp, sets[3].stamp)
    found = model.follow(seen)
    assert (found.stamp, found.model_stamp) == (sets[5].stamp, sets[5].stamp)
    with pytest.raises(ModelError, match=f"expected a stamp of {sets[5].stamp} ns or later"):
        model.look(sets[4])


def test_the_first_set_can_be_rendered_once_it_has_been_looked_at() -> None:
    model = WindowModel(QUICK)
    with pytest.raises(ModelError, match="render: no set has been seen"):
        model.render(CAMERAS[0])
    seen = model.look(frames(0, -0.15, CAMERAS))
    shown = model.render(CAMERAS[0]).rgb
    assert np.array_equal(shown, model.render_frozen(CAMERAS[0]).rgb)
    model.follow(seen)
    assert np.array_equal(shown, model.render(CAMERAS[0]).rgb)


def test_stamps_before_zero_are_stamps_as_others() -> None:
    sets, ours, early = sliding(8, CAMERAS, depth=True), WindowModel(QUICK), WindowModel(QUICK)
    sooner_ns = sets[5].stamp + 1
    for one in sets:
        views = tuple(replace(view, stamp=view.stamp - sooner_ns) for view in one.views)
        state = early.update(replace(one, stamp=one.stamp - sooner_ns, views=views))
        assert np.array_equal(ours.update(one).gaussians.means, state.gaussians.means)
        assert np.array_equal(ours.render(CAMERAS[0]).rgb, early.render(CAMERAS[0]).rgb)
    assert len(state.nodes.ids) and state.stamp > 0
    assert early.parameters_count == ours.parameters_count
    for one in (sets[2], sets[5], sets[6]):
        then = early.render(CAMERAS[0], one.stamp - sooner_ns).rgb
        assert np.array_equal(ours.render(CAMERAS[0], one.stamp).rgb, then)


def test_capacity_is_never_passed(followed: tuple[WindowModel, list[TwinState]]) -> None:
    _, states = followed
    capacity = int(3 * 80 * 60 * QUICK.gaussians_per_pixel)
    assert max(len(state.gaussians.ids) for state in states) <= capacity
    assert all(len(set(state.gaussians.ids)) == len(state.gaussians.ids) for state in states)


def test_states_hold_together(followed: tuple[WindowModel, list[TwinState]]) -> None:
    _, states = followed
    for state in states:
        cloud, nodes = state.gaussians, state.nodes
        assert cloud.nodes.max(initial=-1) < len(nodes.ids)
        carried = cloud.nodes >= 0
        apart = np.linalg.norm(cloud.means[carried] - nodes.positions[cloud.nodes[carried]], axis=1)
        assert (apart <= nodes.radii[cloud.nodes[carried]] + 1e-4).all()
        assert (cloud.tiers[~carried] != Tier.RIGID).all()
        for values in (*vars(cloud).values(), *vars(nodes).values()):
            assert np.isfinite(values.astype(np.float64)).all()


def test_what_no_node_carries_and_no_background_learns_is_drawn_in_every_set_where_depth_is_measured() -> None:
    """A thing that changes its looks all the time."""
    model = WindowModel(replace(QUICK, birth=BirthParameters(node_members=1_000)))
    shown = []
    for index in range(36):
        thing = block(0.1)
        thing = replace(thing, rgb=0.3 * thing.rgb + 0.35 + 0.3 * np.sin(index / 3))
        now = seen(index, table() if index < 2 else joined(table(), thing), CAMERAS, depth=True)
        state = model.update(now)
        missed = [
            squared_error(model.render(view.camera).rgb, view.rgb / 255)[mask].mean()
            for view, mask in zip(now.views, state.moving_masks, strict=True)
            if mask.any()
        ]
        shown.append(psnr(np.mean(missed)) if missed else np.inf)
    assert min(shown[8:]) > 24


def test_a_camera_may_go_and_come_back() -> None:
    model = WindowModel(QUICK)
    for index, one in enumerate(sliding(9, CAMERAS, depth=True)):
        views = one.views[:2] if index in (3, 4, 5) else one.views
        state = model.update(replace(one, views=views))
        assert len(state.moving_masks) == len(views)


def test_a_camera_that_comes_late_is_explained_too() -> None:
    model = WindowModel(QUICK)
    for index, one in enumerate(sliding(24, CAMERAS, depth=True, still=30)):
        state = model.update(one if index > 2 else replace(one, views=one.views[:2]))
        if index == 3:
            early = squared_error(model.render(CAMERAS[2]).rgb, state.frames.views[2].rgb / 255).mean()
    late = squared_error(model.render(CAMERAS[2]).rgb, state.frames.views[2].rgb / 255).mean()
    assert psnr(late) > psnr(early) + 1


@pytest.mark.parametrize(
    "laid",
    [np.asfortranarray, lambda image: image[::-1].copy()[::-1], lambda image: image[:, ::-1].copy()[:, ::-1]],
    ids=["by columns", "from below", "from the right"],
)
def test_images_may_lie_in_memory_as_turned_ones_do(laid: Callable[[np.ndarray], np.ndarray]) -> None:
    """NumPy turns images without moving their pixels. Depth by columns scrambled what masks took for ground, and what
    lies backwards ended in a traceback."""
    plain, turned = WindowModel(QUICK), WindowModel(QUICK)
    for one in sliding(4, CAMERAS, depth=True):
        views = tuple(
            replace(view, rgb=laid(view.rgb), depth=laid(view.depth), valid=laid(np.ones(view.rgb.shape[:2], bool)))
            for view in one.views
            if view.depth is not None
        )
        expected, found = plain.update(one), turned.update(replace(one, views=views))
        np.testing.assert_array_equal(np.stack(found.moving_masks), np.stack(expected.moving_masks))
    np.testing.assert_array_equal(found.gaussians.means, expected.gaussians.means)


def test_one_camera_is_enough_to_run() -> None:
    model = WindowModel(QUICK)
    for one in sliding(5, CAMERAS[:1]):
        state = model.update(one)
    assert len(state.gaussians.ids) > 0


def test_a_past_stamp_has_the_cloud_that_was_published_then(followed: tuple[WindowModel, list[TwinState]]) -> None:
    model, states = followed
    for state in (states[-6], states[-1]):
        found, published = model.cloud(state.stamp), state.gaussians
        found = found.only(np.argsort(found.ids))
        published = published.only(np.argsort(published.ids))
        for name in ("ids", "tiers", "means", "quats", "scales", "opacities", "rgb"):
            np.testing.assert_allclose(getattr(found, name), getattr(published, name), rtol=0, atol=2e-6, err_msg=name)
    rigid = found.tiers == Tier.RIGID
    assert abs(np.median(found.velocities[rigid, 0]) - BLOCK_SPEED) < 0.2 * BLOCK_SPEED
    assert not found.velocities[found.tiers == Tier.STATIC].any()
    between = model.cloud((states[-6].stamp + states[-5].stamp) // 2)
    assert len(between.means) == len(states[-5].gaussians.means)
    with pytest.raises(ModelError, match="cloud: no set has been seen yet"):
        WindowModel(QUICK).cloud()


def test_a_past_stamp_renders_the_past(followed: tuple[WindowModel, list[TwinState]]) -> None:
    model, states = followed
    now = model.render(CAMERAS[1]).rgb
    same = model.render(CAMERAS[1], states[-1].stamp).rgb
    past = model.render(CAMERAS[1], states[-6].stamp).rgb
    assert np.abs(now - same).max() < 1e-3
    assert np.abs(now - past).max() > 0.05


def test_a_past_stamp_shows_what_has_died_since_as_well_as_it_was_shown_live() -> None:
    model = WindowModel(replace(QUICK, window=48))
    sets = sliding(16, CAMERAS, depth=True)
    live: dict[int, list[np.ndarray]] = {}
    for one in sets:
        then = model.update(one)
        live[one.stamp] = [model.render(view.camera).rgb for view in one.views]
    for index in range(16, 42):  # what is seen through goes within 0.8 s
        now = model.update(frames(index, None, CAMERAS, depth=True))
    assert len(np.setdiff1d(then.gaussians.ids, now.gaussians.ids)) > 50
    for one in sets[4:]:
        for view, shown in zip(one.views, live[one.stamp], strict=True):
            again = model.render(view.camera, one.stamp).rgb
            assert np.abs(again - shown).max() < 1e-3


def test_a_set_looks_as_it_did_whatever_is_made_of_it_afterwards() -> None:
    cameras, decided = rig(64, 48), 0
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=2, levels=24), gaussians_per_pixel=0.3))
    for index in range(20):
        scene = table()
        if index > 3:
            scene = joined(joined(scene, block(0.02 * index - 0.4, -0.25)), block(0.3 - 0.015 * index, 0.3))
        if index > 8:
            scene = joined(scene, block(0.3, 0.02 * index - 0.56))
        one = seen(index, scene, cameras)
        model.update(one)
        decided += len(model.decisions)
        before = [model.render(camera).rgb for camera in cameras]
        model.refine()  # nodes end, and others take their rows
        after = [model.render(camera).rgb for camera in cameras]
        assert max(np.abs(a - b).max() for a, b in zip(before, after, strict=True)) < 1e-3
    assert decided > 5


def test_of_two_sets_with_one_stamp_the_later_is_shown() -> None:
    model = WindowModel(QUICK)
    for one in sliding(8, CAMERAS, depth=True):
        model.update(one)
    again = frames(12, -0.15 + 10 * BLOCK_SPEED * 0.033, CAMERAS, depth=True)
    views = tuple(replace(view, stamp=one.stamp) for view in again.views)
    model.update(replace(one, views=views))
    assert model._begun is not None
    kept, rows = model._begun.past.at(one.stamp, model._nodes).population, torch.nonzero(model._gaussians.alive)[:, 0]
    assert torch.equal(kept.values, model._gaussians.values[rows])


def test_who_takes_the_row_of_one_that_stood_is_not_taken_for_it() -> None:
    model = WindowModel(replace(QUICK, map=replace(QUICK.map, steps=0)))
    for index in range(4):
        model.update(frames(index, -0.15, CAMERAS, depth=True))
    model.refine()
    gaussians = model._gaussians
    own = gaussians.means[gaussians.static_rows]
    on_block = (own[:, 2] > 0.03) & ((own[:, :2] - torch.tensor([-0.15, 0.0])).abs() < 0.1).all(1)
    rows = gaussians.static_rows[on_block]
    gaussians.retire(rows)
    born = gaussians.claim(len(rows)).rows
    assert torch.equal(born, rows)
    gaussians.ids[rows] += 100_000
    gaussians.values[rows, 0] += 0.5
    for index in range(4, 6):  # the backgrounds have not been found anew by then
        model.update(frames(index, -0.15 + 0.02 * (index - 3), CAMERAS, depth=True))
    assert len(rows) > 30
    assert (gaussians.tiers[rows] == int(Tier.STATIC)).all()


def test_a_non_finite_gaussian_is_set_back_and_reported() -> None:
    model = WindowModel(QUICK)
    for one in sliding(8, CAMERAS, depth=True):
        model.update(one)
    poisoned = model._gaussians.moving_rows[:5]
    assert len(poisoned)
    model._gaussians.moment2[poisoned] = torch.nan
    state = model.update(sliding(9, CAMERAS, depth=True)[-1])
    assert np.isfinite(state.gaussians.means).all()
    assert any("not finite" in warning for warning in state.warnings)


@pytest.mark.parametrize(("rate", "depth"), [(1e5, True), (400.0, False)])
def test_a_learning_rate_that_explodes_is_braked_and_reported(rate: float, depth: bool) -> None:
    """What flies out of sight costs the images no more than a third: the steps are no good all the same."""
    wild = replace(QUICK, track=replace(QUICK.track, learning_rate=rate))
    model = WindowModel(wild)
    states: list[TwinState] = []
    gains: list[float] = []
    for index, one in enumerate(sliding(22, CAMERAS, depth=depth)):
        states.append(model.update(one))
        gains += [gain(model, states[-1])] if index >= 14 else []
    warned = [state for state in states if any("made the images worse" in warning for warning in state.warnings)]
    assert warned and len(warned) < 15
    for state in states:
        assert all(np.isfinite(values.astype(np.float64)).all() for values in vars(state.gaussians).values())
    assert np.mean(gains) > 3, "it goes up and down, and stays of use"


def test_a_box_a_hundred_times_too_large_does_no_harm() -> None:
    model = WindowModel(replace(QUICK, seed=replace(QUICK.seed, shell_factor=100 * QUICK.seed.shell_factor)))
    states = [model.update(one) for one in sliding(22, CAMERAS, depth=True)]
    assert gain(model, states[-1]) > 4


def test_long_runs_neither_grow_nor_wear_out() -> None:
    model = WindowModel(QUICK)
    there = sliding(12, CAMERAS, depth=True)
    gap = there[1].stamp - there[0].stamp
    gains: list[float] = []
    sizes: list[int] = []
    for index in range(6):
        passed = there if index % 2 == 0 else there[::-1]
        for step, one in enumerate(passed):
            stamp = there[0].stamp + (12 * index + step) * gap
            views = tuple(replace(view, stamp=stamp) for view in one.views)
            state = model.update(replace(one, stamp=stamp, views=views))
        if index % 2 == 0:
            gains.append(gain(model, state))
        sizes.append(len(state.gaussians.ids))
    assert gains[-1] > gains[0] - 1.5
    assert max(sizes) <= model.capacity
