"""What stands and shows in no camera is taken out, and nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from model_scenes import rig, table

from twin_node.model.backgrounds import Backgrounds
from twin_node.model.gaussians import Gaussians, Newborns
from twin_node.model.plane import Plane
from twin_node.model.pruning import EVERY_SETS, ROUNDS, Pruner, blend_weights
from twin_node.model.rendering import Splats, render
from twin_node.model.sweep import shell_around
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


def pruner(held: Gaussians) -> Pruner:
    """One that watches `held`."""
    return Pruner(held, Backgrounds(Plane(np.array([0.0, 0.0, 1.0]), 0.0), shell_around(CAMERAS, 2.5)))


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


def images(held: Gaussians) -> list[np.ndarray]:
    """What the cameras see."""
    splats = held.standing(held.values[held.static_rows])
    return [seen.rgb.numpy() for seen in render(splats, CAMERAS)]


def test_what_lies_under_others_goes_and_the_images_stay() -> None:
    held = store(with_hidden(40))
    visible = [int((blend_weights(held, held.static_rows, camera)[-40:] > 0.1).sum()) for camera in CAMERAS]
    assert visible == [0, 0, 0]
    before, watched = images(held), pruner(held)
    for _ in range(WHOLE):
        watched.watch(CAMERAS)
    assert len(held) <= len(table().scales)
    for old, new in zip(before, images(held), strict=True):
        assert np.abs(old - new).max() < 0.1 and np.abs(old - new).mean() < 2e-4


def test_blend_weights_add_up_to_what_is_opaque() -> None:
    held = store(table())
    seen = render(held.standing(held.values[held.static_rows]), CAMERAS)
    for camera, image in zip(CAMERAS, seen, strict=True):
        total = float(blend_weights(held, held.static_rows, camera).sum())
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
