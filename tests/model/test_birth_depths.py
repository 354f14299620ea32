"""Depths of newborns where none is measured."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch
from model_scenes import table
from test_steps import MOST, look_at, observe

from twin_node.model import birth_depths
from twin_node.model.birth_depths import CLOSER, FARTHEST, NEAREST, UNKNOWN, Pixels, known_depths
from twin_node.model.births import Births, find_births_reference
from twin_node.model.compiled_births import find_births
from twin_node.model.observation import Observed
from twin_node.model.parameters import BirthParameters
from twin_node.model.rays import look
from twin_node.model.rendering import Rendering
from twin_node.scene import Float64

Find = Callable[[Sequence[Observed], Sequence[Rendering], float, BirthParameters], Births]
RED, BLUE = np.array([0.8, 0.1, 0.1]), np.array([0.1, 0.1, 0.8])


def two_things(one: Observed) -> Rendering:
    """A red thing on the left and a blue one beside it that is deeper, both nearer than what stands still."""
    height, width = one.usable.shape
    rgbd = np.zeros((height, width, 4), np.float32)
    rgbd[..., 3] = one.background.depth
    rgbd[30:50, 30:50] = [*RED, 0.5]
    rgbd[30:50, 50:70] = [*BLUE, 0.6]
    return Rendering(torch.from_numpy(rgbd), torch.ones(height, width))


def test_the_depth_known_around_a_pixel_is_that_of_what_looks_like_it() -> None:
    one = observe(table(), 0.1)[0]
    assert one.background.depth.min() * CLOSER > 0.6
    pixels = Pixels(
        np.array([40, 40, 80]), np.array([48, 50, 100]), np.stack([BLUE, RED, RED]).astype(np.float32), np.full(3, 2)
    )
    known = known_depths(one, two_things(one), pixels, np.full(3, 1.0))
    assert known[:2] == pytest.approx([0.6, 0.5])
    assert 0.5 <= known[2] <= 0.6, "nothing around it: what moves anywhere"


def test_where_nothing_is_known_to_move_a_newborn_is_looked_for_before_the_background() -> None:
    one = observe(table(), 0.1)[0]
    pixels = Pixels(np.array([40]), np.array([48]), RED[None].astype(np.float32), np.array([2]))
    assert known_depths(one, look_at(table())[0], pixels, np.array([2.0])) == pytest.approx([2.0 * UNKNOWN])


def noisy_births(seed: int) -> Births:
    """Births for the moving block, seen through a noise of 26 grey levels."""
    noise = np.random.default_rng(seed)
    observed = [
        replace(one, rgb=np.clip(one.rgb + noise.normal(0, 0.1, one.rgb.shape), 0, 1).astype(np.float32))
        for one in observe(table(), 0.1)
    ]
    return find_births(observed, look_at(table()), MOST)


def off_the_block(births: Births) -> float:
    """How far births lie from the block, mean, m."""
    free = births.means[~births.on_background]
    return float(np.linalg.norm(np.maximum(np.abs(free - [0.1, 0, 0.05]) - [0.08, 0.08, 0.05], 0), axis=1).mean())


def test_neighbours_that_look_alike_settle_the_depth_of_noisy_pixels(monkeypatch: pytest.MonkeyPatch) -> None:
    together = [off_the_block(noisy_births(seed)) for seed in range(4)]
    monkeypatch.setattr(birth_depths, "NEIGHBOUR_PX", 0.1)
    alone = [off_the_block(noisy_births(seed)) for seed in range(4)]
    assert np.mean(together) < 0.8 * np.mean(alone)


@pytest.mark.parametrize("find", [find_births, find_births_reference])
def test_what_no_other_view_looks_at_is_born_in_the_middle_of_where_none_looks(find: Find) -> None:
    observed = observe(table(), 0.1)
    blind = [observed[0], *(replace(one, usable=np.zeros_like(one.usable)) for one in observed[1:])]
    shares = depth_shares(find(blind, look_at(table()), MOST), observed[0])
    assert np.median(shares) == pytest.approx((NEAREST + FARTHEST) / 2, abs=0.03)
    alone = depth_shares(find(observed[:1], look_at(table())[:1], MOST), observed[0])
    assert np.median(alone) == pytest.approx(UNKNOWN, abs=0.03), "a camera without others guesses as before"


def depth_shares(births: Births, one: Observed) -> Float64:
    """[n] depths of what the first view bears before the background, as shares of the background's."""
    seen = look(one.view.camera, births.means[(births.views == 0) & ~births.on_background])
    shares: Float64 = seen.depth / one.background.depth[seen.rows, seen.columns]
    assert len(shares) > 20
    return shares
