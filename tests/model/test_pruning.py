"""What shows in no camera is taken out, and nothing else."""

from __future__ import annotations

import itertools
from dataclasses import replace

import numpy as np
import pytest
import torch
from model_scenes import rig, sliding, table

from twin_node.model import BirthParameters, ModelParameters, SeedParameters, WindowModel, unseen
from twin_node.model.backgrounds import Backgrounds
from twin_node.model.gaussians import Gaussians, Newborns
from twin_node.model.plane import Plane
from twin_node.model.pruning import (
    EVERY_SETS,
    LEAST_MOVING_PX,
    LEAST_PX,
    MOVING_EVERY_S,
    MOVING_ROUNDS,
    ROUNDS,
    MovingPruner,
    Pruner,
)
from twin_node.model.rendering import Splats, render
from twin_node.model.sweep import shell_around
from twin_node.model.unseen import blend_weights
from twin_node.scene import Camera, Tier

CAMERAS = rig()
WHOLE = EVERY_SETS * (ROUNDS * len(CAMERAS) + 1)
"""Sets in which what does not show goes."""


def store(splats: Splats) -> Gaussians:
    """STATIC Gaussians that stand."""
    count = splats.means.shape[1]
    held = Gaussians(count + 50, torch.device("cpu"))
    nobody = torch.full((count,), -1, dtype=torch.int64)
    quats = splats.quats[0]
    held.spawn(Newborns(splats.means[0], quats, splats.scales, splats.opacities, splats.rgb, Tier.STATIC, nobody), 0)
    return held


def pruner(held: Gaussians, most: int | None = None) -> Pruner:
    """One that watches `held`."""
    backgrounds = Backgrounds(Plane(np.array([0.0, 0.0, 1.0]), 0.0), shell_around(CAMERAS, 2.5))
    return Pruner(held, backgrounds, held.capacity if most is None else most)


def with_hidden(count: int) -> Splats:
    """The table, and Gaussians deep under it."""
    whole = table()
    return Splats(
        torch.cat([whole.means, whole.means[:, :count] * 0.2 - torch.tensor([0.0, 0.0, 0.3])], 1),
        torch.cat([whole.quats, whole.quats[:, :count]], 1),
        torch.cat([whole.scales, whole.scales[:count] * 0.3]),
        torch.cat([whole.opacities, whole.opacities[:count]]),
        torch.cat([whole.rgb, whole.rgb[:count]]),
    )


def standing(held: Gaussians) -> Splats:
    """All that stands, in the order of its rows."""
    return held.standing(held.values[held.static_rows])


def images(held: Gaussians) -> list[np.ndarray]:
    """What the cameras see."""
    return [seen.rgb.numpy() for seen in render(standing(held), CAMERAS)]


def test_what_lies_under_others_goes_and_the_images_stay() -> None:
    held = store(with_hidden(40))
    visible = [int((blend_weights(standing(held), camera)[-40:] > 0.1).sum()) for camera in CAMERAS]
    assert visible == [0, 0, 0]
    before, watched = images(held), pruner(held)
    for _ in range(WHOLE):
        watched.watch(CAMERAS)
    assert len(held) <= len(table().scales)
    for old, new in zip(before, images(held), strict=True):
        assert np.abs(old - new).max() < 0.1 and np.abs(old - new).mean() < 2e-4


def test_what_stands_unseen_by_three_cameras_goes_within_two_seconds_at_30_hz_and_not_within_one() -> None:
    held, count = store(with_hidden(40)), len(table().scales)
    hidden, watched = held.static_rows[-40:], pruner(held)
    sets = 0
    while bool(held.alive[hidden].any()) and sets < 60:
        watched.watch(CAMERAS)
        sets += 1
    assert 1.4 < sets / 30 < 1.7
    assert len(held) > 0.9 * count


def test_what_stands_and_shows_a_seventh_of_a_pixel_stays_and_what_shows_a_fifteenth_goes() -> None:
    whole = with_hidden(40)
    shown = torch.stack([blend_weights(whole, camera) for camera in CAMERAS]).amax(0)
    told = (shown < 1 / 15) | (shown > 1 / 7)
    held = store(chosen(whole, told))
    rows, watched = held.static_rows, pruner(held)
    faint = (shown[told] > 0.04) & (shown[told] < 0.2)
    assert 0 < int((faint & (shown[told] < 0.1)).sum()) < int(faint.sum())
    for _ in range(WHOLE):
        watched.watch(CAMERAS)
    assert torch.equal(held.alive[rows], shown[told] > 0.1)


def test_blend_weights_add_up_to_what_is_opaque() -> None:
    held = store(table())
    seen = render(standing(held), CAMERAS)
    for camera, image in zip(CAMERAS, seen, strict=True):
        total = float(blend_weights(standing(held), camera).sum())
        assert total == pytest.approx(float(image.alpha.sum()), rel=1e-3)


def test_what_a_camera_saw_stays_while_that_camera_is_away() -> None:
    held = store(table())
    K = CAMERAS[0].K.copy()
    K[[0, 1], [0, 1]] *= 3
    nearest: Camera = replace(CAMERAS[0], K=K)
    watched = pruner(held)
    for _ in range(3 * WHOLE):
        watched.watch([nearest])
    assert len(held) < len(table().scales)  # of a camera that sees a part alone the rest goes
    held = store(table())
    away = pruner(held)
    away.watch(CAMERAS)
    for _ in range(3 * WHOLE):
        away.watch([nearest])
    assert len(held) == len(table().scales)


def test_a_camera_that_has_left_for_good_is_not_waited_for(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(unseen, "AWAY_SETS", 2 * EVERY_SETS)
    held = store(with_hidden(40))
    watched = pruner(held)
    watched.watch(CAMERAS)
    for _ in range(2 * WHOLE):
        watched.watch(CAMERAS[:2])
    assert len(held) <= len(table().scales)


def test_what_stands_leaves_room_for_what_moves() -> None:
    held = store(table())
    shown = torch.stack([blend_weights(standing(held), camera) for camera in CAMERAS]).amax(0)
    most = len(table().scales) - 30
    least = shown.argsort(stable=True)[:30]
    watched = pruner(held, most)
    for _ in range(EVERY_SETS * len(CAMERAS)):
        assert len(held) == len(table().scales), "not before all cameras were asked"
        watched.watch(CAMERAS)
    assert len(held) == most and not bool(held.alive[least].any())
    for _ in range(EVERY_SETS * len(CAMERAS)):
        watched.watch(CAMERAS)
    assert len(held) > most - 100, "no more of them than that"


def test_what_moves_may_take_all_the_room_that_there_is_and_no_more() -> None:
    """All that the first set was seeded with went as soon as all cameras had been looked through."""
    parameters = ModelParameters(seed=SeedParameters(steps=1), birth=BirthParameters(moving_share=1.0))
    model, counts = WindowModel(parameters), []
    for one in sliding(30, rig(40, 30), depth=True, still=30):
        model.update(one)
        model.refine()
        counts.append(model.tier_counts[Tier.STATIC])
    assert min(counts) > 0.9 * counts[0]


def test_what_the_arm_is_made_of_takes_room_from_what_stands() -> None:
    held, arms = store(with_hidden(30)), slice(len(table().scales), len(table().scales) + 30)
    held.tiers[arms] = int(Tier.ROBOT)
    watched = pruner(held, len(table().scales))
    for _ in range(EVERY_SETS * len(CAMERAS)):
        watched.watch(CAMERAS)
    assert len(held.static_rows) == len(table().scales) - 30
    assert bool(held.alive[arms].all())


@pytest.mark.parametrize(("hidden", "spare"), [(0, 0), (40, 0), (0, 30)])
def test_what_stands_is_drawn_anew_where_something_of_it_went_and_only_there(hidden: int, spare: int) -> None:
    splats = with_hidden(hidden)
    shown = torch.stack([blend_weights(splats, camera) for camera in CAMERAS]).amax(0) >= 2 * LEAST_PX
    shown[len(table().scales) :] = True  # what is hidden stays in, all else shows
    held = store(chosen(splats, shown))
    backgrounds = Backgrounds(Plane(np.array([0.0, 0.0, 1.0]), 0.0), shell_around(CAMERAS, 2.5))
    backgrounds.of(held, CAMERAS)
    watched, count = Pruner(held, backgrounds, len(held) - spare), len(held)
    for _ in range(WHOLE):
        assert not backgrounds.are_behind
        watched.watch(CAMERAS)
        if len(held) < count:
            break
    assert backgrounds.are_behind == (len(held) < count) == (hidden + spare > 0)


def chosen(splats: Splats, which: torch.Tensor) -> Splats:
    """Some of the Gaussians."""
    return Splats(
        splats.means[:, which],
        splats.quats[:, which],
        splats.scales[which],
        splats.opacities[which],
        splats.rgb[which],
    )


def test_what_was_born_within_a_round_is_not_judged_by_it() -> None:
    held = store(with_hidden(10))
    watched = pruner(held)
    for _ in range(EVERY_SETS):
        watched.watch(CAMERAS)
    born = torch.nonzero(~held.alive)[:5, 0]
    held.alive[born] = True
    held.ids[born] = 10_000 + born
    held.tiers[born] = int(Tier.STATIC)
    held.values[born] = held.values[len(table().scales)].repeat(5, 1)
    for _ in range(EVERY_SETS * (ROUNDS * len(CAMERAS) - 1)):
        watched.watch(CAMERAS)
    assert bool(held.alive[born].all())


def moving(splats: Splats, bodies: torch.Tensor) -> Gaussians:
    """RIGID Gaussians of bodies [n] that stand where they were born."""
    held = store(splats)
    rows = held.static_rows
    held.tiers[rows], held.nodes[rows] = int(Tier.RIGID), bodies
    return held


SETS = itertools.count(0, round(MOVING_EVERY_S * 1e9))
"""Stamps of sets that are all looked at, ns."""


def look_around(watched: MovingPruner, held: Gaussians, rounds: int) -> None:
    """Looks through all cameras so many times, with nothing before what moves."""
    for stamp in itertools.islice(SETS, rounds * len(CAMERAS)):
        index = watched.due(CAMERAS, stamp)
        assert index is not None
        rows = held.moving_rows
        watched.look(CAMERAS[index], rows, held.standing(held.values[rows]), held.standing(held.values[:0]))


def test_what_lies_under_its_own_body_goes_when_it_has_for_long() -> None:
    splats, count = with_hidden(40), len(table().scales) + 40
    shows = torch.stack([blend_weights(splats, camera) for camera in CAMERAS]).amax(0) >= LEAST_MOVING_PX
    assert not bool(shows[-40:].any())
    held = moving(splats, torch.zeros(count, dtype=torch.int64))
    watched = MovingPruner(held)
    look_around(watched, held, MOVING_ROUNDS - 1)
    assert len(held) == count
    look_around(watched, held, 1)
    assert torch.equal(held.alive[:count], shows)


def test_what_moves_unseen_by_three_cameras_goes_after_half_a_second_at_30_hz() -> None:
    held = moving(with_hidden(40), torch.zeros(len(table().scales) + 40, dtype=torch.int64))
    rows, watched = held.moving_rows, MovingPruner(held)
    hidden, gone_s = rows[-40:], None
    for tick in range(60):
        index, rows = watched.due(CAMERAS, tick * 33_333_333), held.moving_rows
        if index is not None:
            drawn = held.standing(held.values[rows])
            watched.look(CAMERAS[index], rows, drawn, held.standing(held.values[:0]))
        if gone_s is None and not bool(held.alive[hidden].any()):
            gone_s = tick / 30
    assert gone_s is not None and 0.45 < gone_s < 0.65


def test_what_moves_and_shows_two_fifths_of_a_pixel_stays_and_what_shows_a_fifth_goes() -> None:
    whole = table()
    shown = torch.stack([blend_weights(whole, camera) for camera in CAMERAS]).amax(0)
    told = (shown < 1 / 5) | (shown > 2 / 5)
    held = moving(chosen(whole, told), torch.zeros(int(told.sum()), dtype=torch.int64))
    rows, watched = held.moving_rows, MovingPruner(held)
    assert bool(((shown[told] > 0.1) & (shown[told] < 0.2)).any())
    assert bool(((shown[told] > 0.4) & (shown[told] < 0.6)).any())
    look_around(watched, held, MOVING_ROUNDS)
    assert torch.equal(held.alive[rows], shown[told] > 0.3)


def test_sets_that_come_more_often_are_not_all_looked_at() -> None:
    watched = MovingPruner(moving(table(), torch.zeros(len(table().scales), dtype=torch.int64)))
    half = round(MOVING_EVERY_S * 5e8)
    assert [watched.due(CAMERAS, stamp) is not None for stamp in range(0, 5 * half, half)] == [True, False] * 2 + [True]


def test_a_body_that_is_hidden_whole_stays_until_some_of_it_shows() -> None:
    bodies = torch.zeros(len(table().scales) + 40, dtype=torch.int64)
    bodies[-40:] = 1
    held = moving(with_hidden(40), bodies)
    watched = MovingPruner(held)
    look_around(watched, held, 2 * MOVING_ROUNDS)
    assert bool(held.alive[-90:-50].all())  # its rows; fifty slots are spare
    held.values[len(bodies) - 1, 2] += 0.6  # above the table
    look_around(watched, held, MOVING_ROUNDS)
    assert held.alive[-90:-50].tolist() == [False] * 39 + [True]


def test_what_takes_the_row_of_one_that_has_not_shown_for_long_begins_anew() -> None:
    held = moving(with_hidden(10), torch.zeros(len(table().scales) + 10, dtype=torch.int64))
    watched = MovingPruner(held)
    look_around(watched, held, MOVING_ROUNDS - 1)
    hidden = held.moving_rows[-10:]
    held.retire(hidden)  # between two rounds
    born = held.claim(10)
    assert torch.equal(born.rows, hidden)
    held.ids[hidden] = born.first_id + torch.arange(10)
    held.nodes[hidden] = 0
    look_around(watched, held, MOVING_ROUNDS - 1)
    assert bool(held.alive[hidden].all())
    look_around(watched, held, 1)
    assert not bool(held.alive[hidden].any())
