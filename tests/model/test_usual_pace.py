"""How much a set may change: newborns within their room, and more births and steps of sets that are far apart."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from model_scenes import TICK_NS, frames, rig, sliding

from twin_node.model import BirthParameters, ModelParameters, SeedParameters, TrackParameters, WindowModel, tracker
from twin_node.model.fitting import Fitted, fit_moving
from twin_node.model.population import TURNOVER
from twin_node.model.stages import exhausted, unhurried
from twin_node.model.usual_pace import USUAL_PERIOD_S
from twin_node.scene import GaussianCloud, Tier

QUICK = ModelParameters(seed=SeedParameters(steps=24), gaussians_per_pixel=0.5)
CAMERAS = rig()


def is_moving(cloud: GaussianCloud) -> np.ndarray:
    return np.isin(cloud.tiers, (Tier.RIGID, Tier.DEFORMABLE, Tier.TRANSIENT))


def test_newborns_take_the_room_that_is_free_and_then_replace_few_of_what_was_fitted() -> None:
    most = 40
    birth = replace(QUICK.birth, moving_share=most / int(3 * 80 * 60 * QUICK.gaussians_per_pixel))
    model, known, before = WindowModel(replace(QUICK, birth=birth)), np.zeros(0, np.int64), 0
    fulls = 0
    for one in sliding(24, CAMERAS, depth=True):
        cloud = model.update(one).gaussians
        moving = is_moving(cloud)
        born = np.setdiff1d(cloud.ids[moving], known)
        assert len(born) <= max(most - before, int(TURNOVER * most), len(CAMERAS))
        known, before = np.union1d(known, cloud.ids), int(moving.sum())
        fulls += before >= most
    assert fulls > 10


def test_newborns_replace_more_of_what_moves_where_sets_are_far_apart() -> None:
    """As many in a time as at the usual pace, of a block that goes on by less than its width from set to set."""
    most, ticks = 40, 10
    birth = replace(QUICK.birth, moving_share=most / int(3 * 80 * 60 * QUICK.gaussians_per_pixel))
    model, known, before, borne = WindowModel(replace(QUICK, birth=birth)), np.zeros(0, np.int64), 0, []
    for i in range(12):
        cloud = model.update(frames(i * ticks, -0.3 + 0.06 * i, CAMERAS, depth=True)).gaussians
        moving = is_moving(cloud)
        borne += [len(np.setdiff1d(cloud.ids[moving], known))] if before >= most else []
        known, before = np.union1d(known, cloud.ids), int(moving.sum())
    assert len(borne) > 3
    assert sum(borne) > len(borne) * max(int(TURNOVER * most), len(CAMERAS))
    assert max(borne) <= int(ticks * TICK_NS * 1e-9 / USUAL_PERIOD_S * TURNOVER * most)


@pytest.mark.parametrize(
    ("ticks", "waits", "stretch"), [(1, False, 1.0), (4, False, 1.98), (10, False, 4.0), (10, True, 1.0)]
)
def test_sets_that_are_far_apart_take_more_steps_unless_others_wait(
    ticks: int, waits: bool, stretch: float, monkeypatch: pytest.MonkeyPatch
) -> None:
    taken, model = [], WindowModel(replace(QUICK, track=TrackParameters(steps=5)))

    def counting(*arguments: object) -> Fitted:
        taken.append(arguments[-2])
        return fit_moving(*arguments)

    monkeypatch.setattr(tracker, "fit_moving", counting)
    for i in range(8):
        model.update(frames(i * ticks, -0.1 + 0.02 * i, CAMERAS, depth=True))
        model.refine(exhausted if waits else unhurried)
    assert taken[-1] == int(5 * stretch)


@pytest.mark.parametrize(("pause_s", "depth"), [(20 * 60, True), (10 * 3600, False)])
def test_a_node_of_which_little_is_seen_outlives_a_pause_of_minutes_and_of_hours(pause_s: int, depth: bool) -> None:
    """What it may have moved by grew with the square of the pause, until what one pixel tells could not be solved for:
    its place was no number, and the model ended with the next drawing."""
    birth = BirthParameters(node_members=1, per_set=3 if depth else 200)
    model = WindowModel(replace(QUICK, seed=SeedParameters(steps=4), birth=birth))
    for index, one in enumerate(sliding(10, rig(40, 30), depth)):
        later = max(index - 7, 0) * pause_s * 1_000_000_000
        views = tuple(replace(view, stamp=view.stamp + later) for view in one.views)
        state = model.update(replace(one, stamp=one.stamp + later, views=views))
        model.refine()
        assert np.isfinite(state.gaussians.means).all()
        assert np.isfinite(state.nodes.positions).all()
