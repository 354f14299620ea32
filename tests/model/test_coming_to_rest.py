"""What comes to rest, by how much sets tell of it, and wakes again, by how much of it looks otherwise."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from model_scenes import BLOCK_SPEED, rig, sliding, table
from test_steps import CAMERAS, look_at, observe, world

from twin_node.model import ModelParameters, SeedParameters, WindowModel
from twin_node.model.backgrounds import Backgrounds
from twin_node.model.decisions import ChangedView, Kind, LogEvidence
from twin_node.model.gaussians import QUAT, Gaussians
from twin_node.model.long_rest import STANDS_NS
from twin_node.model.mapping import LACKING
from twin_node.model.nodes import Nodes
from twin_node.model.observation import Observed
from twin_node.model.parameters import MapParameters
from twin_node.model.rendering import Rendering
from twin_node.model.rest import MOST_FILLS, Rest
from twin_node.model.resting import RESTS, Resting
from twin_node.model.sweep import shell_around
from twin_node.scene import Float64, Tier

ORIGIN = torch.zeros(3, dtype=torch.float64)
SECOND_NS = 1_000_000_000
GROUP = 7
"""Id of the node that something at rest had."""


def told(nats: float) -> LogEvidence:
    """A set that resting explains better than moving by so much."""
    return LogEvidence(one=-100.0, two=-np.inf, at_rest=-100.0 + nats, misfit=1.0)


def sets_until_settled(nats: list[float | None], step_s: float) -> int:
    """After how many sets a node settles of which each tells so many nats, and None nothing: the last for good."""
    nodes = Nodes(2, 4)
    nodes.give_birth(ORIGIN, ORIGIN)
    resting = Resting(Gaussians(4, torch.device("cpu")), nodes, Backgrounds(None, shell_around(CAMERAS, 2.5)))
    for count in range(100):
        now = nats[min(count, len(nats) - 1)]
        if resting.settle({} if now is None else {0: told(now)}, step_s):
            return count + 1
    return -1


@pytest.mark.parametrize(("nats", "sets"), [(RESTS, 5), (20 * RESTS, 5), (RESTS / 2, 9), (RESTS / 4, 17)])
def test_a_set_that_hardly_tells_of_rest_counts_for_less_and_none_for_more_than_itself(nats: float, sets: int) -> None:
    assert sets_until_settled([nats], 0.25) == sets


def test_rest_is_counted_in_seconds_whatever_the_rate_of_the_sets() -> None:
    assert sets_until_settled([RESTS], 0.125) == 9


def test_one_set_without_rest_and_it_is_counted_from_the_beginning() -> None:
    assert sets_until_settled([RESTS, RESTS, RESTS, RESTS, None, RESTS], 0.25) == 5 + 5


def test_nobody_has_rested_through_a_pause_in_which_no_image_came() -> None:
    assert sets_until_settled([RESTS], 20.0) == 2


@pytest.mark.parametrize("pause_s", [2, 20])
def test_what_stood_through_a_pause_and_goes_on_is_no_furniture_and_as_fast_as_before(pause_s: int) -> None:
    """What was told over the pause outweighed all that came for a second, in which the block counted as standing."""
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=24), gaussians_per_pixel=0.5))
    settled = []
    for index, one in enumerate(sliding(22, rig(), depth=True)):
        later_ns = pause_s * SECOND_NS if index >= 14 else 0
        views = tuple(replace(view, stamp=view.stamp + later_ns) for view in one.views)
        state = model.update(replace(one, stamp=one.stamp + later_ns, views=views))
        model.refine()
        settled += [decision for decision in model.decisions if decision.kind == Kind.SETTLED]
        if index == 19:
            assert state.nodes.velocities[:, 0].max() == pytest.approx(BLOCK_SPEED, abs=0.3 * BLOCK_SPEED)
    assert not settled


def test_a_place_that_has_had_its_new_gaussians_may_have_more_once_it_changes_again() -> None:
    one, block = observe(table(), None)[0], (np.array([40]), np.array([60]))
    rest, stamp, lacks = Rest(one), one.view.stamp, []
    for by in (0.3, -0.3):
        changed = replace(one, rgb=np.clip(one.rgb + np.float32(by), 0, 1))
        for _ in range(MOST_FILLS + 1):
            for _ in range(8):
                stamp += SECOND_NS // 10
                rest.see(replace(changed, view=replace(one.view, stamp=stamp)), MapParameters())
            lacks.append(bool(rest.lacking[block][0] > LACKING))
            rest.fill(*block)
    assert lacks == 2 * [*MOST_FILLS * [True], False]


def test_all_that_a_node_carries_stands_once_it_settles_and_the_node_is_free_again() -> None:
    gaussians, nodes = Gaussians(4, torch.device("cpu")), Nodes(2, 4)
    for _ in range(2):
        nodes.give_birth(ORIGIN, ORIGIN)
    settled = int(nodes.ids[0])
    gaussians.alive[:3] = True
    gaussians.nodes[:] = torch.tensor([0, 0, 1, 0])  # the last one is dead
    gaussians.values[:, QUAT] = torch.tensor([1.0, 0.0, 0.0, 0.0])
    backgrounds = Backgrounds(None, shell_around(CAMERAS, 2.5))
    resting = Resting(gaussians, nodes, backgrounds)
    assert not nodes.free and not backgrounds.are_outdated
    assert not resting.settle({0: told(RESTS), 1: told(0.1 * RESTS)}, 0.6)
    [decision] = resting.settle({0: told(RESTS), 1: told(0.1 * RESTS)}, 0.6)
    assert (decision.kind, decision.node, decision.grounds) == (Kind.SETTLED, settled, told(RESTS))
    assert [gaussians.rested[row] == settled for row in range(4)] == [True, True, False, False]
    assert gaussians.nodes[:3].tolist() == [-1, -1, 1]
    assert nodes.free
    assert backgrounds.are_outdated, "the next set is compared with what stands by then"


def test_what_a_node_carries_has_kept_still_once_none_of_it_has_lain_where_something_moves_for_long() -> None:
    nodes = Nodes(4, 4)
    for _ in range(2):
        nodes.give_birth(ORIGIN, ORIGIN)
    resting = Resting(Gaussians(4, torch.device("cpu")), nodes, Backgrounds(None, shell_around(CAMERAS, 2.5)))
    carriers = np.array([0, 0, 1, -1])

    def asked(stamp: int, *still: bool) -> list[bool]:
        """With a set every second in between, of which all of it keeps still."""
        for between in range(nodes.stamp + SECOND_NS, stamp, SECOND_NS):
            nodes.stamp = between
            resting.has_kept_still(carriers, np.ones(4, bool))
        nodes.stamp = stamp
        return list(map(bool, resting.has_kept_still(carriers, np.array(still))))

    assert asked(1, True, True, True, True) == [False] * 4, "who is new to it has not kept still for long"
    assert asked(2, True, False, True, True) == [False] * 4
    assert asked(1 + STANDS_NS, True, True, True, True) == [False] * 4
    assert asked(2 + STANDS_NS, True, True, True, True) == [False, False, True, False]
    assert asked(3 + STANDS_NS, True, True, True, True) == [True, True, True, False]
    assert asked(4 + STANDS_NS, False, True, True, True) == [False, False, True, False]


def test_time_without_sets_does_not_count_as_having_kept_still() -> None:
    """Who was there may have gone meanwhile: what is left of them would stand where nobody is."""
    nodes, carriers, still = Nodes(4, 4), np.array([0]), np.ones(1, bool)
    nodes.give_birth(ORIGIN, ORIGIN)
    resting = Resting(Gaussians(4, torch.device("cpu")), nodes, Backgrounds(None, shell_around(CAMERAS, 2.5)))
    assert not resting.has_kept_still(carriers, still)
    nodes.stamp += 3 * STANDS_NS
    assert not resting.has_kept_still(carriers, still)
    for _ in range(round(STANDS_NS / SECOND_NS)):
        nodes.stamp += SECOND_NS
        kept = resting.has_kept_still(carriers, still)
    assert kept


class AtRest:
    """As many Gaussians of a table as one view shows are one thing at rest; `changed` of them look otherwise."""

    def __init__(self, count: int, changed: int, group: int = GROUP, beside: int = 0) -> None:
        """Of the Gaussians `beside` those are another thing at rest, which looks as it did."""
        static = table()
        self.gaussians, backgrounds = world(static)
        backgrounds.of(self.gaussians, CAMERAS)
        self.backgrounds = backgrounds
        self.seeing: Observed = observe(static, None)[0]
        self.drawn: Rendering = look_at(static)[0]
        seen = self.seeing.background.static
        pixels = seen.rows * CAMERAS[0].width + seen.columns
        shown = seen.inside & ~self.seeing.background.occluded(seen) & self.seeing.usable[seen.rows, seen.columns]
        _, first = np.unique(pixels[shown], return_index=True)
        apart = np.flatnonzero(shown)[first]
        own = apart[:count]
        self.rows = backgrounds.rows[torch.from_numpy(own)]
        self.gaussians.rested[self.rows] = group
        self.gaussians.rested[backgrounds.rows[torch.from_numpy(apart[count : count + beside])]] = group + 1
        self.at = seen.rows[own], seen.columns[own]
        self.depths: Float64 = seen.depth[own]
        rgb = self.drawn.pixels[..., :3].copy()
        rgb[seen.rows[own[:changed]], seen.columns[own[:changed]]] += 0.5
        self.seeing = replace(self.seeing, rgb=rgb, active=np.zeros_like(self.seeing.active))
        self.nodes = Nodes(1, 4)
        self.resting = Resting(self.gaussians, self.nodes, backgrounds)

    def hide(self, share: float) -> None:
        """Something that moves is drawn before it, at a share of its depth."""
        active, pixels = np.zeros_like(self.seeing.active), self.drawn.pixels.copy()
        active[self.at] = True
        pixels[(*self.at, 3)] = share * self.depths
        self.seeing = replace(self.seeing, active=active)
        self.drawn = replace(self.drawn, rgbd=torch.from_numpy(pixels))

    @property
    def wakes(self) -> bool:
        """Whether it has a node now."""
        self.woken = self.resting.wake([self.seeing], [self.drawn])
        return bool(self.woken)


@pytest.mark.parametrize(
    ("shown", "changed", "wakes"), [(20, 5, True), (20, 4, False), (24, 5, False), (4, 3, True), (4, 2, False)]
)
def test_what_rests_wakes_where_a_quarter_of_what_is_seen_looks_otherwise_and_no_single_ones(
    shown: int, changed: int, wakes: bool
) -> None:
    thing = AtRest(shown, changed)
    assert not thing.backgrounds.are_outdated
    assert thing.wakes == wakes
    assert thing.backgrounds.are_outdated == wakes, "the next set is compared with what still stands"
    assert int((thing.gaussians.rested == GROUP).sum()) == (0 if wakes else shown)
    if wakes:
        assert int((thing.gaussians.nodes >= 0).sum()) == shown, "all of it, whatever has changed"
        [decision] = thing.woken
        assert (decision.kind, decision.node, decision.grounds) == (Kind.WOKEN, GROUP, ChangedView(shown, changed))


@pytest.mark.parametrize(("share", "wakes"), [(0.5, False), (1.0, True)])
def test_what_something_that_moves_hides_does_not_look_otherwise(share: float, wakes: bool) -> None:
    thing = AtRest(20, 10)
    thing.hide(share)
    assert thing.wakes == wakes


def test_pixels_of_no_use_say_nothing_of_what_rests() -> None:
    thing = AtRest(20, 10)
    usable = thing.seeing.usable.copy()
    usable[thing.at] = False
    thing.seeing = replace(thing.seeing, usable=usable)
    assert not thing.wakes


def test_what_stands_behind_something_else_does_not_look_otherwise() -> None:
    thing = AtRest(20, 10)
    nearer = replace(thing.seeing.background, depth=0.5 * thing.seeing.background.depth)
    thing.seeing = replace(thing.seeing, background=nearer)
    assert not thing.wakes


def test_things_at_rest_are_looked_at_each_by_itself() -> None:
    """The first node of all may be the one that came to rest."""
    thing = AtRest(8, 4, group=0, beside=40)
    assert thing.wakes
    assert [one.node for one in thing.woken] == [0]
    assert int((thing.gaussians.rested == 1).sum()) == 40


def test_what_has_died_of_a_thing_at_rest_does_not_look_otherwise() -> None:
    thing = AtRest(20, 5)
    thing.gaussians.alive[thing.rows[:2]] = False
    assert not thing.wakes


def test_what_is_laid_down_stands_for_the_node_that_carried_it_and_for_none_where_none_did() -> None:
    gaussians, nodes = Gaussians(5, torch.device("cpu")), Nodes(2, 4)
    for _ in range(2):
        nodes.give_birth(ORIGIN, ORIGIN)
    gaussians.alive[:] = True
    gaussians.tiers[:], gaussians.nodes[:] = int(Tier.RIGID), torch.tensor([0, 0, 1, -1, 1])
    gaussians.values[:, QUAT] = torch.tensor([1.0, 0.0, 0.0, 0.0])
    backgrounds = Backgrounds(None, shell_around(CAMERAS, 2.5))
    resting = Resting(gaussians, nodes, backgrounds)
    resting.lay(torch.tensor([], dtype=torch.int64))
    assert not backgrounds.are_behind
    resting.lay(torch.tensor([0, 2, 3]))
    assert backgrounds.are_behind
    assert [gaussians.tiers[row] == Tier.STATIC for row in range(5)] == [True, False, True, True, False]
    assert gaussians.nodes.tolist() == [-1, 0, -1, -1, 1]
    assert gaussians.rested.tolist() == [nodes.ids[0], -1, nodes.ids[1], -1, -1]
    assert not nodes.free, "what is left of them is still carried"


def test_what_rests_goes_on_resting_while_there_is_no_node_for_it() -> None:
    thing = AtRest(20, 10)
    row = thing.nodes.give_birth(ORIGIN, ORIGIN)
    assert not thing.wakes
    assert int((thing.gaussians.rested == GROUP).sum()) == 20
    thing.nodes.retire(torch.tensor([row]))
    assert thing.wakes
