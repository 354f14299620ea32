"""Steps towards what cameras see at rest: they lead there, move who learns alone, and end where nothing is missed."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from model_scenes import rig, table
from torch import Tensor

from twin_node.model.gaussians import RGB, Gaussians, Newborns
from twin_node.model.kernels import kernels
from twin_node.model.least_squares import AtRest, Step
from twin_node.model.rendering import render
from twin_node.scene import Tier

CAMERAS = rig()


def stored() -> Gaussians:
    """The table's Gaussians in a store."""
    whole = table()
    count = whole.means.shape[1]
    nobody = torch.full((count,), -1, dtype=torch.int64)
    store = Gaussians(count, torch.device("cpu"))
    born = Newborns(whole.means[0], whole.quats[0], whole.scales, whole.opacities, whole.rgb, Tier.STATIC, nobody)
    store.spawn(born, 0)
    return store


def at_rest(store: Gaussians, with_depth: bool = False) -> list[AtRest]:
    """What the rig sees of a store."""
    views = []
    for camera, seen in zip(CAMERAS, render(store.standing(store.values), CAMERAS), strict=True):
        shape = (camera.height, camera.width)
        surface = np.full(shape, 3.0, np.float32)
        depth = np.where(seen.alpha.numpy() > 0.99, seen.depth.numpy(), 0) if with_depth else np.zeros(shape)
        views.append(AtRest(camera, seen.rgb.numpy(), depth.astype(np.float32), surface, np.ones(shape, bool)))
    return views


def missed(store: Gaussians, views: list[AtRest]) -> float:
    """Mean squared error of colour."""
    seen = render(store.standing(store.values), CAMERAS)
    return float(np.mean([np.square(one.rgb.numpy() - view.rgb).mean() for one, view in zip(seen, views, strict=True)]))


def step(store: Gaussians, rows: Tensor, learners: Tensor, views: list[AtRest]) -> None:
    """One step towards all views."""
    taken = Step(store, rows, learners)
    for view in views:
        taken.look(view)
    taken.take()


@pytest.mark.parametrize("with_depth", [False, True])
def test_steps_lead_back_to_what_is_seen_and_stop_there(with_depth: bool) -> None:
    store = stored()
    views = at_rest(store, with_depth)
    rows, everybody = store.static_rows, torch.ones(len(store.static_rows), dtype=torch.bool)
    right = store.values.clone()
    step(store, rows, everybody, views)
    assert (store.values - right).abs().max() < (1e-4 if not with_depth else 2e-2)
    store.values[:, RGB] = (right[:, RGB] + 0.1).clamp(0, 1)
    store.values[:, 7:10] -= 0.1
    errors = [missed(store, views)]
    for _ in range(20):
        step(store, rows, everybody, views)
        errors.append(missed(store, views))
    assert errors[-1] < 0.05 * errors[0]
    assert max(np.diff(errors)) < 0.05 * errors[0]


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
def test_the_compiled_kernel_takes_the_step_that_torch_does() -> None:
    store, other = stored(), stored()
    views = at_rest(store)
    rng = torch.Generator().manual_seed(4)
    learners = torch.rand(len(store.static_rows), generator=rng) > 0.2
    for one, take in ((store, Step.take), (other, Step.take_reference)):
        one.values[:, RGB] = (one.values[:, RGB] + 0.15).clamp(0, 1)
        one.values[::3, 7:10] += 0.3
        begun = Step(one, one.static_rows, learners)
        for view in views:
            begun.look(view)
        before = one.values.clone()
        one.retire(one.static_rows[::7])
        one.largest[5::11] -= 1.0  # some are as large as they may be
        one.values[3::19, 0] = torch.nan  # and some lead nowhere
        take(begun)
        assert ((one.values - before).abs().amax(1) > 1e-4).float().mean() > 0.3
    assert store.refused == other.refused > 0
    assert np.array_equal(store.values.numpy(), other.values.numpy(), equal_nan=True)


def test_who_does_not_learn_or_is_not_counted_stays_to_the_bit() -> None:
    store = stored()
    views = at_rest(store)
    left = np.zeros_like(views[0].counted)
    left[:, :40] = True
    store.values[:, RGB] *= 0.8
    before, rows = store.values.clone(), store.static_rows
    learners = torch.arange(len(rows)) % 2 == 0
    step(store, rows, learners, [replace(view, counted=left) for view in views[:1]])
    changed = (store.values != before).any(1)
    assert 20 < int(changed.sum()) < int(learners.sum())
    assert not bool((changed[rows] & ~learners).any())


def test_what_leaves_or_begins_to_move_while_views_are_looked_through_takes_no_step() -> None:
    store = stored()
    views = at_rest(store)
    store.values[:, RGB] *= 0.8
    rows, everybody = store.static_rows, torch.ones(len(store.static_rows), dtype=torch.bool)
    taken = Step(store, rows, everybody)
    for view in views:
        taken.look(view)
    left, moves = rows[::3], rows[1::3]
    store.retire(left)
    store.tiers[moves] = int(Tier.TRANSIENT)
    before = store.values.clone()
    taken.take()
    changed = (store.values != before).any(1)
    assert not bool(changed[left].any()) and not bool(changed[moves].any())
    assert int(changed[rows[2::3]].sum()) > 20
