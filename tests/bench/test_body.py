"""The node of the thing of one colour: its own Gaussians are told from others of that colour, its motion is scored."""

from __future__ import annotations

import numpy as np
import torch

from twin_node.bench.body import BodyTally
from twin_node.bench.truth import ColourOf
from twin_node.model.rendering import Splats, render
from twin_node.scene import Camera, Float64, FrameSet, GaussianCloud, NodeStates, Tier, TwinState, View

ORANGE, ORANGE_HUE = (255, 100, 20), 9
WIDTH, HEIGHT = 64, 48
SPACING_M, SPEED = 0.04, 0.8
PERIOD_NS = 50_000_000
LATTICE = SPACING_M * (np.indices((5, 5, 5)).reshape(3, -1).T - 2.0)
"""[125, 3] m, a block about its middle."""


def camera(axis: int) -> Camera:
    """1.5 m from the origin, looking along x or y."""
    T = np.eye(4)
    T[:3, :3] = np.array([[[0, 0, 1], [-1, 0, 0], [0, -1, 0]], [[1, 0, 0], [0, 0, 1], [0, -1, 0]]], float)[axis]
    T[axis, 3] = -1.5
    return Camera(f"cam{axis}", WIDTH, HEIGHT, np.array([[80.0, 0, WIDTH / 2], [0, 80, HEIGHT / 2], [0, 0, 1]]), T)


CAMERAS = (camera(0), camera(1))


def splats(points: Float64) -> Splats:
    """Opaque balls at points [n, 3]."""
    n = len(points)
    quats = torch.zeros(1, n, 4)
    quats[..., 0] = 1
    means = torch.from_numpy(points).float()[None]
    return Splats(means, quats, torch.full((n, 3), SPACING_M / 2), torch.full((n,), 0.95), torch.ones(n, 3))


def state(tick: int, elsewhere: Float64) -> TwinState:
    """An orange block that moves along y, and Gaussians of its colour `elsewhere` [n, 3], where images are grey."""
    stamp = tick * PERIOD_NS
    middle = np.array([0, -0.2 + SPEED * stamp * 1e-9, 0])
    block = LATTICE + middle
    views = []
    for one, seen in zip(CAMERAS, render(splats(block), list(CAMERAS)), strict=True):
        image = np.full((HEIGHT, WIDTH, 3), 90, np.uint8)
        image[seen.alpha.numpy() >= 0.5] = ORANGE
        views.append(View(one, stamp, image))
    points = np.concatenate([block, elsewhere]).astype(np.float32)
    n, f = len(points), np.float32
    rgb = np.tile(np.array(ORANGE, f) / 255, (n, 1))
    carriers = np.repeat(np.array([0, 1], np.int32), [len(block), len(elsewhere)])
    drawn = splats(points.astype(np.float64))
    cloud = GaussianCloud(
        points, drawn.quats[0].numpy(), drawn.scales.numpy(), drawn.opacities.numpy(), rgb, np.zeros((n, 3), f),
        np.full(n, int(Tier.RIGID), np.uint8), np.arange(n, dtype=np.uint32), carriers,
    )  # fmt: skip
    places = np.stack([middle, np.zeros(3)])
    nodes = NodeStates(
        np.arange(2, dtype=np.uint32), places, np.tile([1.0, 0, 0, 0], (2, 1)), np.array([[0, SPEED, 0], [0, 0, 0]]),
        np.zeros((2, 3)), np.full(2, 0.001), np.full(2, 0.1),
    )  # fmt: skip
    nothing = np.zeros((HEIGHT, WIDTH), bool)
    return TwinState(stamp, FrameSet(stamp, tuple(views)), cloud, nodes, (nothing, nothing), (None, None))


def scored(elsewhere: Float64) -> BodyTally:
    tally = BodyTally(ColourOf(ORANGE_HUE), 0)
    for tick in range(11):
        tally.add(state(tick, elsewhere))
    return tally


def test_the_motion_of_a_block_is_foretold_better_than_by_standing_still() -> None:
    found = scored(np.zeros((0, 3))).score()
    assert found.carried_share == 1.0
    assert found.images >= 6, "one view sees it cross, the other approach and part of it leave"
    ours, still = found.iou["ours"], found.iou["persistence"]
    assert ours is not None and still is not None
    assert ours > still + 0.1


def test_what_has_the_colour_where_the_images_have_another_is_not_the_thing() -> None:
    """More than the block has: they would be taken for it."""
    lifted = np.repeat(LATTICE, 2, 0) + np.array([0, 0, 0.3])
    alone, beside = scored(np.zeros((0, 3))).score(), scored(lifted).score()
    assert beside.carried_share == 1.0
    assert beside.iou == alone.iou


def test_what_hangs_before_it_in_one_view_is_not_the_thing() -> None:
    """On its pixels in the camera that sees it approach, beside them in the other."""
    before = np.repeat(LATTICE, 2, 0) * 0.3 + np.array([-0.6, 0, 0])
    assert scored(before).score().carried_share == 1.0


def test_a_thing_in_two_nodes_is_shared() -> None:
    """A third of what lies where both views show it is another's."""
    tally = BodyTally(ColourOf(ORANGE_HUE), 0)
    one = state(3, np.zeros((0, 3)))
    shared = np.where(np.arange(len(LATTICE)) % 3 == 0, 1, 0).astype(np.int32)
    cloud = GaussianCloud(**{**vars(one.gaussians), "nodes": shared})
    tally.add(TwinState(**{**vars(one), "gaussians": cloud}))
    assert tally.score().carried_share == np.mean(shared == 0)
