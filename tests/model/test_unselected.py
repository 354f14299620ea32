"""Selection and bending left out: what stands still learns too, and no node is ever bent."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from model_scenes import frames, rig, sliding

from twin_node.model import ModelParameters, SeedParameters, WindowModel
from twin_node.model.decisions import BendEvidence, Kind
from twin_node.model.evidence import PROMOTE
from twin_node.model.quality import psnr, squared_error
from twin_node.scene import Tier

CAMERAS = rig()
PLAIN = ModelParameters(seed=SeedParameters(steps=12), gaussians_per_pixel=0.3)
UNSELECTED = replace(PLAIN, track=replace(PLAIN.track, selects=False, learning_rate=1.0))
STILL = replace(PLAIN, map=replace(PLAIN.map, steps=0))


def followed(parameters: ModelParameters) -> tuple[WindowModel, float]:
    """A model that has followed the block, and the largest change of a Gaussian that stood all the while, m."""
    model = WindowModel(parameters)
    states = [model.update(one) for one in sliding(6, CAMERAS, depth=True)]
    first, last = states[0].gaussians, states[-1].gaussians.only(states[-1].gaussians.tiers == Tier.STATIC)
    _, before, after = np.intersect1d(first.ids, last.ids, return_indices=True)
    return model, float(np.abs(first.means[before] - last.means[after]).max())


def test_without_selection_what_stands_learns_too() -> None:
    _, moved = followed(STILL)
    _, moved_unselected = followed(replace(UNSELECTED, map=STILL.map))
    assert moved == 0
    assert moved_unselected > 1e-4


def test_without_selection_the_images_are_explained_all_the_same() -> None:
    model, _ = followed(UNSELECTED)
    view = frames(5, -0.15 + 5 / 30, CAMERAS).views[0]
    assert psnr(squared_error(model.render(view.camera).rgb, view.rgb / 255).mean()) > 20


def test_without_selection_steps_that_diverge_are_followed_by_smaller_ones() -> None:
    """The rate stayed as it was, so that of every third set here nothing was learnt."""
    model = WindowModel(replace(UNSELECTED, track=replace(UNSELECTED.track, learning_rate=4.0)))
    warnings = [model.update(one).warnings for one in sliding(12, CAMERAS, depth=True)]
    braked = [line for lines in warnings for line in lines if "steps made the images worse" in line]
    assert braked[0].endswith("at a rate of 0.4")
    assert len(braked) <= 2


def test_where_nothing_bends_every_node_stays_rigid() -> None:
    """Evidence says that every node bends: it does where it may, and not where it may not; what is found is told."""
    tiers, told = [], []
    for bends in (True, False):
        parameters = replace(PLAIN, track=replace(PLAIN.track, bends=bends))
        model = WindowModel(parameters)
        for one in sliding(14, CAMERAS, depth=True):
            model._nodes.evidence = torch.full_like(model._nodes.evidence, 40.0)
            model.update(one)
            told += [(bends, found) for found in model.decisions if isinstance(found.grounds, BendEvidence)]
        tiers.append(model.tier_counts[Tier.DEFORMABLE])
    assert tiers[0] > 0
    assert tiers[1] == 0
    assert told
    for bends, found in told:
        assert bends and found.kind is Kind.BENDS and found.node == found.other
        assert found.grounds.evidence > PROMOTE and found.grounds.evidence == pytest.approx(36 + found.grounds.gain)
        assert found.grounds.strained <= found.grounds.rigid and found.grounds.count >= 0
