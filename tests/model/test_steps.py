"""The steps of a set, each held to a scene in which the right answer is known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
import torch
from model_scenes import block, frames, joined, rig, table

from twin_node.model.adoption import Adopted, as_newborns, store
from twin_node.model.alignment import solve_twists
from twin_node.model.backgrounds import Backgrounds, grow
from twin_node.model.births import Births
from twin_node.model.cells import Cells
from twin_node.model.compiled_deaths import judge_static, refuted_moving
from twin_node.model.deaths import (
    Shapes,
    are_needed,
    clashing,
    judge_static_reference,
    lie_still,
    refuted_moving_reference,
)
from twin_node.model.evidence import DEMOTE, PROMOTE, Fits, accumulate
from twin_node.model.flow import flows_between
from twin_node.model.gaussians import Gaussians, Newborns
from twin_node.model.held import SKIRT_PX, held_pixels, held_reference
from twin_node.model.kernels import kernels
from twin_node.model.nodes import Nodes, Poses
from twin_node.model.observation import Observed, Observer
from twin_node.model.occluders import occluders, occluders_reference
from twin_node.model.plane import Plane
from twin_node.model.quality import MOVING_THRESHOLD
from twin_node.model.rendering import Rendering, Splats, render
from twin_node.model.rest import Rest
from twin_node.model.sweep import shell_around
from twin_node.scene import Bool, Tier

CAMERAS = rig(120, 90)
MOST = 200
"""Births per set."""


def world(splats: Splats) -> tuple[Gaussians, Backgrounds]:
    """STATIC Gaussians `splats` and their backgrounds."""
    count = splats.means.shape[1]
    store = Gaussians(count, torch.device("cpu"))
    nobody = torch.full((count,), -1, dtype=torch.int64)
    store.spawn(
        Newborns(splats.means[0], splats.quats[0], splats.scales, splats.opacities, splats.rgb, Tier.STATIC, nobody),
        0,
    )
    plane = Plane(np.array([0.0, 0.0, 1.0]), 0.0)
    return store, Backgrounds(plane, shell_around(CAMERAS, 2.5))


def observe(
    static: Splats, block_x: float | None, depth: bool = False, blind: int | None = None, is_dark: bool = False
) -> list[Observed]:
    """The block at `block_x` over what `static` says stands still, with true masks; view `blind` sees nothing move.

    No depth is measured of a block that `is_dark`, nor beside it.
    """
    store, backgrounds = world(static)
    known = backgrounds.of(store, CAMERAS)
    now = frames(1, block_x, CAMERAS, depth)
    with torch.no_grad():
        ground = [seen.rgb.numpy() for seen in render(static, CAMERAS)]
    masks = [
        np.abs(view.rgb / 255 - rgb).max(-1) > MOVING_THRESHOLD for view, rgb in zip(now.views, ground, strict=True)
    ]
    masks = [mask & (index != blind) for index, mask in enumerate(masks)]
    if is_dark:
        depths = [np.where(grow(mask, 2), 0, view.depth) for view, mask in zip(now.views, masks, strict=True)]
        now = replace(now, views=tuple(replace(view, depth=d) for view, d in zip(now.views, depths, strict=True)))
    observer = Observer(0.15)
    with torch.no_grad():
        rest = [to_bytes(seen) for seen in render(static, CAMERAS)]
    still = replace(now, views=tuple(replace(view, rgb=rgb) for view, rgb in zip(now.views, rest, strict=True)))
    observer.observe(still, [np.zeros_like(mask) for mask in masks], [None] * 3, known, 0.0)
    return observer.observe(now, masks, [None] * 3, known, 0.033)


def to_bytes(seen: Rendering) -> np.ndarray:
    """The rendering as a camera would give it."""
    return (seen.rgb.clamp(0, 1).numpy() * 255).round().astype(np.uint8)


def look_at(splats: Splats) -> list[Rendering]:
    """What the cameras see."""
    with torch.no_grad():
        return render(splats, CAMERAS)


def balls(points: np.ndarray, radius: float) -> Shapes:
    """Round Gaussians of `radius` (m) at points [n, 3]."""
    return Shapes(points.astype(np.float32), np.full(len(points), radius))


def test_what_a_view_sees_through_is_refuted() -> None:
    observed = observe(table(), 0.1)
    points = np.array([[0.1, 0.0, 0.06], [-0.3, 0.2, 0.1]])
    gone = refuted_moving(observed, [balls(points, 0.0)] * 3, np.ones(2, bool))
    assert gone.tolist() == [False, True]


@pytest.mark.parametrize("refuted", [refuted_moving, refuted_moving_reference])
def test_nothing_is_seen_through_where_no_depth_is_measured(refuted: Callable[..., Bool]) -> None:
    """Dark cloth, hair, glass: a thing that is not measured has not gone."""
    observed = observe(table(), 0.1, depth=True, is_dark=True)
    middle = [balls(np.array([[0.1, 0.0, 0.06]]), 0.0)] * 3
    assert all(one.active.any() and not one.nearest[one.moving].any() for one in observed)
    assert not refuted(observed, middle, np.ones(1, bool)).any()


def test_what_hangs_over_the_edge_of_what_moves_is_left_to_the_fit() -> None:
    observed, middle = observe(table(), 0.1), np.array([[0.1, 0.0, 0.06]])
    for radius in (0.01, 0.1):
        assert not refuted_moving(observed, [balls(middle, radius)] * 3, np.ones(1, bool)).any()


def test_what_reaches_in_from_beyond_the_edge_is_refuted_too() -> None:
    seeing = observe(table(), 0.1)[0]
    camera = seeing.view.camera
    right = camera.T_base_cam[:3, :3] @ np.array([(camera.width / 2 + 4) / camera.K[0, 0], 0, 1])
    beyond = (camera.T_base_cam[:3, 3] + 0.8 * right)[None]
    seeing = replace(seeing, background=replace(seeing.background, depth=np.full_like(seeing.background.depth, 9.0)))
    reaching = [refuted_moving([seeing], [balls(beyond, radius)], np.ones(1, bool)) for radius in (0.01, 0.05)]
    assert [bool(one[0]) for one in reaching] == [False, True]


@pytest.mark.parametrize("depth", [False, True])
def test_what_alone_explains_what_depth_is_measured_of_is_needed(depth: bool) -> None:
    observed = observe(table(), 0.1, depth)
    points = np.array([[0.1, 0.0, 0.1], [-0.3, 0.2, 0.0], [9.0, 9.0, 9.0]])
    assert are_needed(observed, [balls(points, 0.01)] * 3).tolist() == [depth, False, False]


def test_what_no_view_shows_to_move_lies_still() -> None:
    observed = observe(table(), 0.1, blind=1)
    points = np.array([[0.1, 0.0, 0.06], [-0.3, 0.2, 0.0], [9.0, 9.0, 9.0]])
    assert lie_still(observed, [balls(points, 0.01)] * 3).tolist() == [False, True, True]


@pytest.mark.parametrize("depth", [False, True])
def test_static_gaussians_of_a_thing_that_left_are_told_from_the_rest(depth: bool) -> None:
    static = joined(table(), block(-0.2))
    observed = observe(static, 0.25, depth)
    evidence = judge_static(observed, look_at(joined(table(), block(0.25))))
    of_block = static.means[0, :, 2].numpy() > 0.06
    assert evidence.left[of_block].mean() > 0.2
    assert evidence.left[~of_block].mean() < 0.03


def test_what_is_behind_a_thing_that_left_leaves_with_it_where_depth_shows_the_ground() -> None:
    static = joined(table(), block(-0.2))
    observed = observe(static, 0.25, depth=True)
    shown = look_at(joined(table(), block(0.25)))
    of_block = static.means[0, :, 2].numpy() > 0.06
    for judge in (judge_static, judge_static_reference):
        assert judge(observed, shown).left[of_block].mean() > 0.95


@pytest.mark.parametrize("depth", [False, True])
def test_what_depth_and_colour_both_refute_needs_no_second_look(depth: bool) -> None:
    static = joined(table(), block(-0.2))
    observed = observe(static, 0.25, depth)
    left = judge_static(observed, look_at(joined(table(), block(0.25)))).left
    of_block = static.means[0, :, 2].numpy() > 0.06
    for one in observed:
        seen = one.background.static
        as_seen = torch.from_numpy(one.rgb[seen.rows, seen.columns])
        assert not clashing([one], left, as_seen).any(), "what looks like what is behind it waits"
    found = clashing(observed, left, torch.zeros_like(static.rgb))
    assert not (found & ~left).any()
    assert (found[of_block & left].mean() > 0.5) if depth else not found.any()


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
@pytest.mark.parametrize("depth", [False, True])
def test_what_the_kernels_refute_is_what_is_refuted_in_numpy(depth: bool) -> None:
    noise = np.random.default_rng(6)
    static = joined(table(), block(-0.2))
    observed = []
    for one in observe(static, 0.25, depth):
        usable, moving, near = (noise.random(one.usable.shape) < share for share in (0.95, 0.1, 0.3))
        surprise = one.surprise + noise.uniform(0, 0.1, one.surprise.shape).astype(np.float32)
        masks = {"usable": one.usable & usable, "moving": one.moving | moving, "near_moving": one.near_moving ^ near}
        observed.append(replace(one, **masks, surprise=surprise))
    count = 2000
    points = noise.uniform([-0.8, -0.8, -0.3], [0.8, 0.8, 1.4], (count, 3))
    shapes = Shapes(points.astype(np.float32), noise.uniform(0.001, 0.2, count))
    seen = [replace(shapes, means=(points + noise.normal(0, 0.01, points.shape)).astype(np.float32)) for _ in observed]
    carried = noise.random(count) < 0.5
    found, expected = refuted_moving(observed, seen, carried), refuted_moving_reference(observed, seen, carried)
    assert 0.1 < expected.mean() < 0.95
    assert np.count_nonzero(found != expected) <= 1  # a pixel may be the next one by rounding
    shown = look_at(joined(table(), block(0.25)))
    for count in (1, 3):
        given = observed[:count], shown[:count]
        judged, reference = judge_static(*given), judge_static_reference(*given)
        assert reference.left.any() and reference.moving.any()
        assert np.array_equal(judged.left, reference.left) and np.array_equal(judged.moving, reference.moving)


@pytest.mark.parametrize("depth", [False, True])
def test_flow_from_rendering_to_image_gives_the_motion_of_a_node(depth: bool) -> None:
    shift = np.array([0.02, 0.01, 0.0])
    observed = observe(table(), 0.1 + shift[0], depth)
    moved = block(0.1 + shift[0], shift[1])
    observed = [
        replace(
            one, view=replace(one.view, rgb=(seen.rgb.clamp(0, 1).numpy() * 255).astype(np.uint8)), rgb=seen.rgb.numpy()
        )
        for one, seen in zip(observed, look_at(joined(table(), moved)), strict=True)
    ]
    before = block(0.1)
    moving = Splats(before.means.expand(3, -1, -1), before.quats.expand(3, -1, -1), *list(vars(before).values())[2:])
    renderings = look_at(joined(table(), before))
    flows = flows_between(renderings, observed)
    origins = torch.tensor([0.1, 0.0, 0.05], dtype=torch.float64).expand(3, 1, 3)
    own = torch.arange(before.means.shape[1])
    left = before.means[0, :, 0].numpy() < 0.1
    nowhere, one = np.zeros((2, 3)), np.zeros(2, np.int64)
    cells = Cells(np.array([1, 2]), one, one, left.astype(np.int64), nowhere, nowhere)
    twists = solve_twists(observed, renderings, flows, moving, own, cells, origins, 0.05)
    assert twists.linear[0].numpy() == pytest.approx(shift, abs=0.008)
    assert twists.angular[0].norm() < 0.12
    assert 0 < twists.sigmas[0] < 0.01


def test_flow_of_a_view_is_the_same_beside_others_and_none_where_nothing_moves() -> None:
    observed, renderings = observe(table(), 0.12, False), look_at(joined(table(), block(0.1)))
    still = replace(observed[1], near_moving=np.zeros_like(observed[1].near_moving))
    views = [observed[0], still, observed[2]]
    together = flows_between(renderings, views)
    alone = [flows_between([shown], [one])[0] for shown, one in zip(renderings, views, strict=True)]
    assert all(np.array_equal(a, b) for a, b in zip(together, alone, strict=True))
    assert together[0].any() and together[2].any()
    assert together[1].shape == (*still.near_moving.shape, 2) and not together[1].any()


def test_newborns_come_in_one_batch_each_with_the_tier_of_who_carries_it() -> None:
    at = np.arange(5.0)
    births = Births(
        means=np.stack([at, at, at], 1),
        radii=0.01 + at,
        rgb=np.full((5, 3), 0.5, np.float32),
        on_background=np.array([True, False, True, False, False]),
        lasting=np.array([True, False, False, False, False]),
        views=np.zeros(5, np.int64),
    )
    adopted = Adopted(np.array([-1, -1, -1, 0, -1]), np.array([-1, -1, -1, 7, -1]))
    poses = Poses(torch.tensor([[[1.0, 0, 0]]]).double(), torch.tensor([[[1.0, 0, 0, 0]]]).double())
    tiers = torch.tensor([Tier.DEFORMABLE], dtype=torch.uint8)
    born = as_newborns(births, adopted, poses, tiers, torch.device("cpu"))
    assert isinstance(born.tiers, torch.Tensor) and born.homeless is not None and born.founders is not None
    assert born.tiers.tolist() == [Tier.DEFORMABLE, Tier.TRANSIENT, Tier.TRANSIENT, Tier.TRANSIENT, Tier.STATIC]
    assert born.homeless.tolist() == [False, True, True, False, False]
    assert born.nodes.tolist() == [0, -1, -1, -1, -1] and born.founders.tolist() == [7, -1, -1, -1, -1]
    assert born.means[:, 0].tolist() == [2, 1, 4, 2, 0], "the first in the frame of its node, a metre on"
    assert born.scales[:, 2].numpy() == pytest.approx(0.01 + np.array([3, 1, 4, 2, 0]))


@pytest.mark.skipif(kernels() is None, reason="no compiled kernels here")
@pytest.mark.parametrize(("capacity", "last"), [(90, Tier.STATIC), (40, Tier.TRANSIENT)])
def test_the_compiled_kernel_stores_newborns_as_torch_does(capacity: int, last: Tier) -> None:
    generator, count = np.random.default_rng(5), 60
    on_background = generator.random(count) < 0.5
    births = Births(
        generator.normal(size=(count, 3)),
        generator.uniform(0.001, 0.1, count),
        generator.random((count, 3)).astype(np.float32),
        on_background,
        on_background & (generator.random(count) < 0.5),
        generator.integers(0, 3, count),
    )
    nodes = Nodes(4, 3)
    nodes.stamp, nodes.tiers[2] = 11, int(Tier.DEFORMABLE)
    carriers = np.where(on_background, -1, generator.integers(-1, 4, count))
    adopted = Adopted(carriers, np.where(carriers >= 0, carriers + 20, -1))
    quats = torch.from_numpy(generator.normal(size=(3, 4, 4)))
    poses = Poses(torch.from_numpy(generator.normal(size=(3, 4, 3))), quats / quats.norm(dim=-1, keepdim=True))
    stores = []
    for _ in range(2):
        gaussians = Gaussians(capacity, torch.device("cpu"))
        for field in vars(gaussians).values():
            if isinstance(field, torch.Tensor) and field.dtype != torch.bool:
                field.fill_(3)  # what rows held before
        gaussians.alive[::7] = True
        stores.append(gaussians)
    compiled, plain = stores
    rows = store(births, adopted, poses, nodes, compiled)
    expected = plain.spawn(as_newborns(births, adopted, poses, nodes.tiers, torch.device("cpu")), nodes.stamp)
    assert torch.equal(rows, expected) and len(rows) == min(count, capacity - len(range(0, capacity, 7)))
    for name, field in vars(plain).items():
        if isinstance(field, torch.Tensor):
            assert torch.equal(getattr(compiled, name), field), name
    assert compiled.claim(1).first_id == plain.claim(1).first_id
    assert {Tier.RIGID, Tier.DEFORMABLE, Tier.TRANSIENT} <= set(plain.tiers[expected].tolist())
    assert plain.tiers[expected[-1]] == last


def test_evidence_needs_more_than_the_extra_parameters_are_worth() -> None:
    def fits(rigid: float, strained: float, count: float) -> Fits:
        return Fits(*(torch.tensor([value], dtype=torch.float64) for value in (rigid, strained, count)))

    none = torch.zeros(1, dtype=torch.float64)
    assert accumulate(none, fits(400, 360, 400)) < 0
    assert accumulate(none, fits(400, 160, 400)) > 0
    assert accumulate(none, fits(4000, 3600, 400)) < 0, "errors ten times as large as claimed are no strain"
    assert accumulate(none, fits(400, 160, 20)) == 0
    bent = stiff = none
    for _ in range(60):
        bent, stiff = accumulate(bent, fits(400, 200, 400)), accumulate(stiff, fits(400, 396, 400))
    assert bent > PROMOTE
    assert stiff < DEMOTE


def test_a_rendering_is_held_to_every_pixel_that_a_moving_gaussian_shows_in() -> None:
    observed = observe(table(), 0.1)
    outside = np.argwhere(~grow(observed[0].active, 2 * SKIRT_PX))
    row, column = outside[len(outside) // 2]
    one = observed[0]
    point = (
        one.view.camera.T_base_cam[:3, 3] + 1.5 * one.background.depth[row, column] * one.background.rays[row, column]
    )
    floater = replace(block(0.1), means=torch.from_numpy(point).float().expand(3, 1, 3))
    masks = held_pixels(observed, floater)
    assert masks[0][row, column] and not one.active[row, column]
    for mask, view in zip(masks, observed, strict=True):
        assert mask[grow(view.active, SKIRT_PX) & view.usable].all()
    assert masks[0].mean() < 0.9


def test_the_compiled_kernel_holds_a_rendering_to_the_pixels_that_numpy_does() -> None:
    rng = np.random.default_rng(3)
    observed = [
        replace(one, active=rng.random(one.usable.shape) > 0.995, usable=rng.random(one.usable.shape) > 0.1)
        for one in observe(table(), 0.1)
    ]
    scattered = np.concatenate([rng.normal(0, 0.4, (3, 40, 3)), rng.normal(0, 4, (3, 40, 3))], 1).astype(np.float32)
    masks = held_pixels(observed, replace(block(0.1), means=torch.from_numpy(scattered)))
    for mask, plain in zip(masks, held_reference(observed, scattered), strict=True):
        assert np.array_equal(mask, plain)
        assert 0.05 < mask.mean() < 0.9


def test_what_can_stand_before_a_moving_thing_is_found_and_no_more() -> None:
    store, backgrounds = world(table())
    known = backgrounds.of(store, CAMERAS)
    above, under = (np.full((3, 1, 3), [0, 0, z], np.float32) for z in (0.2, -0.3))
    assert not occluders(known, above).any()
    assert 0 < occluders(known, under).sum() < len(store) / 4


def test_the_compiled_kernel_finds_what_stands_before_as_numpy_does() -> None:
    store, backgrounds = world(table())
    known = backgrounds.of(store, CAMERAS)
    rng = np.random.default_rng(5)
    near, far = rng.normal(0, 0.2, (3, 6, 3)), rng.normal(0, 5, (3, 20, 3))
    for points in (near, far, np.concatenate([near, far], 1), near[:, :0]):
        moving = points.astype(np.float32)
        assert np.array_equal(occluders(known, moving), occluders_reference(known, moving))
    assert occluders(known, near.astype(np.float32)).any()


@pytest.mark.parametrize("depth", [False, True])
def test_what_is_seen_at_rest_is_by_kernel_what_it_is_in_numpy(depth: bool) -> None:
    """Noise, pixels that something passes, others that are not usable, and depth that comes and goes."""
    rng, one = np.random.default_rng(6), observe(table(), 0.1, depth)[0]
    compiled, plain = Rest(one), Rest(one)
    shape = one.usable.shape
    for index in range(1, 5):
        rgb = np.clip(one.rgb + rng.normal(0, 0.05, one.rgb.shape), 0, 1).astype(np.float32)
        measured = None if one.view.depth is None else one.view.depth * (rng.random(shape) < 0.7)
        seen = replace(
            one,
            view=replace(one.view, stamp=one.view.stamp + index * 100_000_000, depth=measured),
            rgb=rgb,
            usable=rng.random(shape) > 0.1,
            near_moving=rng.random(shape) > 0.8,
        )
        found = compiled.look(seen, np.float32(0.1), np.float32(0.15))
        expected = plain.look_reference(seen, np.float32(0.1), np.float32(0.15))
        for name, own in expected._asdict().items():
            assert np.array_equal(getattr(found, name), own), name
        assert np.array_equal(compiled.rgb, plain.rgb)
        assert np.array_equal(compiled.depth, plain.depth)
    assert found.counted.any() and found.stirred.any() and not found.counted.all()
