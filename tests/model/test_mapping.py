"""What stands still is refined beside the tracking: where it is wrong, and nowhere else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from model_scenes import frames, rig, sliding

from twin_node.model import MapParameters, ModelParameters, SeedParameters, WindowModel
from twin_node.model.quality import psnr, squared_error
from twin_node.scene import FrameSet, Tier, TwinState

QUICK = ModelParameters(seed=SeedParameters(steps=60), gaussians_per_pixel=0.5)
UNREFINED = replace(QUICK, map=MapParameters(steps=0))
CAMERAS = rig()


def brighter(one: FrameSet, by: float) -> FrameSet:
    """The set in another light."""
    views = tuple(replace(v, rgb=(v.rgb * by).clip(0, 255).astype(np.uint8)) for v in one.views)
    return replace(one, views=views)


def shown_db(model: WindowModel, state: TwinState) -> float:
    """PSNR of the newest set, mean over views."""
    return float(
        np.mean([psnr(squared_error(model.render(v.camera).rgb, v.rgb / 255).mean()) for v in state.frames.views])
    )


def still(rows: TwinState) -> np.ndarray:
    """What STATIC Gaussians are, [n, 14]."""
    cloud = rows.gaussians.only(rows.gaussians.tiers == Tier.STATIC)
    return np.column_stack([cloud.means, cloud.quats, cloud.scales, cloud.opacities, cloud.rgb])


def test_a_light_that_changes_a_little_is_taken_up() -> None:
    gained = []
    for parameters in (UNREFINED, QUICK):
        model = WindowModel(parameters)
        for index in range(40):
            state = model.update(brighter(frames(index, None, CAMERAS), 1.0 if index < 3 else 1.08))
        gained.append(shown_db(model, state))
    assert gained[1] > gained[0] + 2


def test_a_scene_at_rest_stays_as_it_is_to_the_bit() -> None:
    model = WindowModel(QUICK)
    states = [model.update(frames(index, -0.15, CAMERAS)) for index in range(12)]
    assert np.array_equal(still(states[0]), still(states[-1]))


def test_refining_at_once_or_with_the_next_set_is_the_same() -> None:
    clouds = []
    for at_once in (False, True):
        model = WindowModel(QUICK)
        for one in sliding(14, CAMERAS):
            state = model.update(one)
            if at_once:
                model.refine()
                model.refine()
        clouds.append(state.gaussians)
    assert clouds[0].means.tobytes() == clouds[1].means.tobytes()
    assert clouds[0].rgb.tobytes() == clouds[1].rgb.tobytes()


def test_what_moves_is_not_learnt_as_ground() -> None:
    model = WindowModel(QUICK)
    before = still(model.update(sliding(1, CAMERAS)[0]))
    for one in sliding(12, CAMERAS):
        state = model.update(replace(one, stamp=one.stamp + 1, views=one.views))
    far = before[before[:, 1] < -0.4]
    after = still(state)
    assert all((np.abs(after[:, :3] - row[:3]).sum(1) < 1e-6).any() for row in far)
