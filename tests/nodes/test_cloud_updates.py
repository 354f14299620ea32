"""Who keeps the last whole cloud and the newest update has the model as it is."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from twin_node.model.kernels import kernels
from twin_node.nodes.cloud_updates import CloudUpdates, changes_between, changes_reference, updated
from twin_node.scene import GaussianCloud, Tier


def cloud(ids: list[int], tiers: list[Tier], at: float = 0.0) -> GaussianCloud:
    n = len(ids)
    return GaussianCloud(
        means=np.full((n, 3), at, np.float32),
        quats=np.tile(np.array([1, 0, 0, 0], np.float32), (n, 1)),
        scales=np.full((n, 3), 0.02, np.float32),
        opacities=np.full(n, 0.9, np.float32),
        rgb=np.full((n, 3), 0.5, np.float32),
        velocities=np.zeros((n, 3), np.float32),
        tiers=np.array(tiers, np.uint8),
        ids=np.array(ids, np.uint32),
        nodes=np.full(n, -1, np.int32),
    )


STATIC, RIGID = Tier.STATIC, Tier.RIGID
WHOLE = cloud([7, 3, 9, 5], [STATIC, STATIC, RIGID, RIGID])


def after(now: GaussianCloud, whole: GaussianCloud = WHOLE) -> tuple[GaussianCloud, GaussianCloud]:
    """What is told to have changed, and what a reader has by it, in the order of ids."""
    updates = CloudUpdates()
    updates.whole(whole)
    changed = updates.changed(now)
    shown = updated(whole, changed, now.only(now.tiers != STATIC))
    return changed, shown.only(np.argsort(shown.ids))


@pytest.mark.parametrize(
    "now",
    [
        cloud([7, 3, 9, 5], [STATIC, STATIC, STATIC, RIGID]),  # one came to rest
        cloud([7, 3, 9], [STATIC, RIGID, RIGID]),  # one began to move, one that moved died
        cloud([3, 9, 5, 12], [STATIC, RIGID, RIGID, STATIC]),  # one that stood died, another was born
        cloud([12, 13], [STATIC, RIGID]),
        cloud([], []),
    ],
)
def test_a_reader_has_what_the_model_has(now: GaussianCloud) -> None:
    now = now.only(np.argsort(now.ids))
    shown = after(now)[1]
    for name, values in vars(now).items():
        assert np.array_equal(vars(shown)[name], values), name


@pytest.mark.parametrize(
    ("name", "little", "much"),
    [("rgb", 0.03, 0.05), ("opacities", -0.07, -0.09), ("scales", 0.004, 0.006), ("means", 0.004, 0.006)],
)
def test_what_stands_is_told_again_where_it_looks_otherwise(name: str, little: float, much: float) -> None:
    def changed(by: float) -> list[int]:
        values = vars(WHOLE)[name].copy()
        values[1] += np.float32(by)
        told: list[int] = after(replace(WHOLE, **{name: values}))[0].ids.tolist()
        return told

    assert changed(little) == []
    assert changed(much) == [3]


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
def test_compiled_changes_are_the_plain_ones() -> None:
    """Of clouds of which some Gaussians are the same, some differ a little more or less, and some come and go."""
    rng = np.random.default_rng(1)
    for count in (0, 1, 400):
        then = cloud(sorted(rng.permutation(600)[:count].tolist()), rng.choice([STATIC, RIGID], count).tolist())
        now = cloud(rng.permutation(600)[:count].tolist(), rng.choice([STATIC, RIGID], count).tolist())
        seen = {name: vars(now)[name] + np.float32(0.0) for name in ("means", "scales", "opacities", "rgb")}
        for name, much in (("means", 0.003), ("scales", 0.003), ("opacities", 0.06), ("rgb", 0.03)):
            seen[name] += rng.normal(0, much, seen[name].shape).astype(np.float32)
        for one, other in ((replace(now, **seen), then), (then, then), (now, cloud([], [])), (cloud([], []), then)):
            for found, plain in zip(changes_between(one, other), changes_reference(one, other), strict=True):
                assert np.array_equal(found, plain)
    changed, gone = changes_between(replace(now, **seen), then)
    assert 20 < changed.sum() < 380
    assert 20 < gone.sum() < 380


def test_changes_are_those_since_the_last_whole_cloud() -> None:
    updates = CloudUpdates()
    rested = replace(WHOLE, tiers=np.zeros(4, np.uint8))
    assert not len(updates.changed(rested).ids)  # before the first
    updates.whole(WHOLE)
    assert updates.changed(rested).ids.tolist() == [9, 5]
    updates.whole(rested)
    assert not len(updates.changed(rested).ids)
    updates.whole(cloud([], []))
    assert updates.changed(rested).ids.tolist() == [7, 3, 9, 5]


def test_what_is_gone_is_told_with_no_opacity() -> None:
    changed = after(cloud([3, 9, 5, 12], [STATIC, RIGID, RIGID, STATIC]))[0]
    assert dict(zip(changed.ids.tolist(), (changed.opacities > 0).tolist(), strict=True)) == {12: True, 7: False}


def test_what_comes_to_rest_is_shown_while_one_of_the_two_is_a_set_older() -> None:
    updates = CloudUpdates()
    updates.whole(WHOLE)
    before = WHOLE.only(WHOLE.tiers != STATIC)
    rested = replace(WHOLE, tiers=np.array([STATIC, STATIC, STATIC, RIGID], np.uint8))
    for moving in (None, before, rested.only(rested.tiers != STATIC)):
        assert sorted(updated(WHOLE, updates.changed(rested), moving).ids.tolist()) == [3, 5, 7, 9]
