"""What a set does to a model: who is seen when, who makes room, and who goes."""

from __future__ import annotations

import copy
from dataclasses import replace

import pytest
import torch
from model_scenes import TICK_NS, block, frames, joined, rig, seen, sliding, table

from twin_node.model import BirthParameters, ModelParameters, SeedParameters, WindowModel
from twin_node.model.population import MOVING_JUDGED_S, Population
from twin_node.model.quality import moving_pixels, psnr, squared_error
from twin_node.model.slack import AT_EASE
from twin_node.model.tracker import BRAKE
from twin_node.model.upkeep import Seen, Upkeep
from twin_node.scene import FrameSet, Tier

CAMERAS, SMALL = rig(), rig(48, 36)
QUICK = ModelParameters(seed=SeedParameters(steps=8, levels=24), gaussians_per_pixel=0.5)


@pytest.fixture(scope="module")
def following() -> WindowModel:
    """One that follows the block with depth; to be copied."""
    model = WindowModel(QUICK)
    for one in sliding(12, CAMERAS, depth=True):
        model.update(one)
    return model


def population_of(model: WindowModel) -> Population:
    """That of a model which has begun."""
    assert model._begun is not None
    return model._begun.tracker._population


def staggered(index: int, speed: float, late_ns: int) -> FrameSet:
    """Set `index` of a block that goes along x at `speed`, m/s; each camera has taken its image `late_ns` before the
    next one."""
    stamp, views = frames(index, None, CAMERAS).stamp, []
    for number, camera in enumerate(CAMERAS):
        own = stamp - (len(CAMERAS) - 1 - number) * late_ns
        at = -0.25 + speed * max((own - frames(2, None, CAMERAS).stamp) * 1e-9, 0.0)
        (view,) = seen(index, joined(table(), block(at)), [camera], depth=True).views
        views.append(replace(view, stamp=own))
    return FrameSet(stamp, tuple(views), sequence=index)


def test_each_image_is_followed_at_its_own_time() -> None:
    model, speed, sets = WindowModel(QUICK), 0.8, 15
    for index in range(sets):
        state = model.update(staggered(index, speed, 14_000_000))
    early = state.frames.views[0]
    assert state.stamp - early.stamp == 28_000_000
    moves = moving_pixels(early.rgb / 255, frames(0, -0.25, CAMERAS).views[0].rgb / 255)
    then, now = (
        psnr(squared_error(model.render(early.camera, stamp).rgb, early.rgb / 255)[moves].mean())
        for stamp in (early.stamp, state.stamp)
    )
    assert then > now + 1, "as if it had been taken later, or earlier than it was"


def test_what_stands_takes_one_step_a_set_until_none_has_waited_for_some(
    following: WindowModel, monkeypatch: pytest.MonkeyPatch
) -> None:
    model, begin, asked = copy.deepcopy(following), Upkeep.begin, []

    def noted(self: Upkeep, seen: Seen, steps: int) -> None:
        asked.append(steps)
        begin(self, seen, steps)

    monkeypatch.setattr(Upkeep, "begin", noted)
    all_of_them, waits = model.parameters.map.steps, 2
    for index, one in enumerate(sliding(12 + waits + 1 + AT_EASE, CAMERAS, depth=True)[12:]):
        model.update(one)
        model.refine(lambda index=index: index != waits)
    assert all_of_them > 1
    assert asked == [all_of_them] * (1 + waits) + [1] * (AT_EASE - 1) + [all_of_them]


def test_who_matters_least_to_the_images_makes_room(following: WindowModel) -> None:
    model = copy.deepcopy(following)
    population, gaussians = population_of(model), model._gaussians
    rows = gaussians.moving_rows
    influence = gaussians.influence(rows)
    population._make_room(population._room().left + 5)
    assert len(rows) > 20
    gone = ~gaussians.alive[rows]
    assert int(gone.sum()) == 5
    assert influence[gone].max() <= influence[~gone].min()
    population._make_room(population._room().left - 5)
    assert len(gaussians.moving_rows) == len(rows) - 5, "where there is room nobody goes"


def test_what_no_node_carries_ends_with_its_life_and_what_one_carries_does_not() -> None:
    life_s = 0.2
    model = WindowModel(replace(QUICK, birth=BirthParameters(transient_s=life_s)))
    oldest = dict.fromkeys((Tier.RIGID, Tier.TRANSIENT), 0.0)
    for one in sliding(34, SMALL):
        model.update(one)
        gaussians = model._gaussians
        for tier in oldest:
            own = gaussians.alive & (gaussians.tiers == tier)
            if own.any():
                oldest[tier] = max(oldest[tier], 1e-9 * int(one.stamp - gaussians.births[own].min()))
    assert life_s < oldest[Tier.TRANSIENT] <= life_s + MOVING_JUDGED_S + 2e-9 * TICK_NS
    assert oldest[Tier.RIGID] > life_s + MOVING_JUDGED_S + 2e-9 * TICK_NS


def test_nodes_end_with_the_last_that_they_carry(following: WindowModel) -> None:
    model = copy.deepcopy(following)
    assert model.nodes_count
    for index in range(12, 44):
        model.update(frames(index, None, CAMERAS, depth=True))
    carried = torch.unique(model._gaussians.nodes[model._gaussians.alive])
    assert set(model._nodes.rows.tolist()) == set(carried[carried >= 0].tolist())
    assert not model.nodes_count


def test_what_waits_while_no_images_come_is_found_where_it_was(following: WindowModel) -> None:
    """It was foretold to go on: after half a minute nine metres away, and what stood there had to be born again."""
    model, last = copy.deepcopy(following), sliding(12, CAMERAS, depth=True)[-1]
    before, stamp = model.cloud(), last.stamp + 30_000_000_000
    views = tuple(replace(view, stamp=stamp) for view in last.views)
    after = model.update(replace(last, stamp=stamp, views=views)).gaussians
    carried = [cloud.means[cloud.tiers == Tier.RIGID] for cloud in (before, after)]
    assert len(carried[1]) >= len(carried[0]) > 20
    assert abs(carried[1].mean(0) - carried[0].mean(0)).max() < 0.02


def test_a_rate_that_was_braked_is_whole_again_after_sets_that_went_well(following: WindowModel) -> None:
    model = copy.deepcopy(following)
    assert model._begun is not None
    tracker = model._begun.tracker
    tracker._pace = BRAKE
    for one in sliding(40, CAMERAS, depth=True)[12:]:
        model.update(one)
    assert tracker._pace == 1
