"""What the live model does on the CPU by compiled kernels it does on another device by torch and gsplat."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from model_scenes import TICK_NS, frames, rig, sliding, with_joints
from pretended import NAME, OTHERS, Traffic, at_hand, pretended

from twin_node.model import ModelParameters, SeedParameters, WindowModel
from twin_node.robot import ArmModel, ur_model
from twin_node.scene import FrameSet


def followed(device: str, sets: list[FrameSet], steps: int = 8, arm: ArmModel | None = None) -> list[float]:
    """How well a model there draws each of the sets when it has followed it (dB)."""
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=steps), device=device), arm=arm)
    psnr = []
    for one in sets:
        model.update(one)
        errors = [model.render(view.camera).rgb - view.rgb / np.float32(255) for view in one.views]
        psnr.append(float(-10 * np.log10(np.square(errors).mean())))
        model.refine()
    return psnr


@pytest.mark.parametrize("depth", [False, True])
@pytest.mark.parametrize("device", OTHERS)
def test_a_scene_is_followed_there_as_here(device: str, depth: bool) -> None:
    sets = sliding(8, rig(56, 42), depth)
    with at_hand(device):
        there = followed(device, sets)
    assert there == pytest.approx(followed("cpu", sets), abs=0.3)


@pytest.mark.parametrize("device", OTHERS)
def test_an_arm_is_learnt_there_as_here(device: str) -> None:
    arm, still = ur_model("ur5e"), frames(0, None, rig(56, 42), depth=True)
    turning = [np.array([0.3 + 0.1 * index, -1.2, 1.4, -1.6, -1.5, 0.0]) for index in range(4)]
    sets = [
        with_joints(replace(still, stamp=still.stamp + index * TICK_NS), arm.joint_names, q)
        for index, q in enumerate(turning)
    ]
    with at_hand(device):
        there = followed(device, sets, arm=arm)
    assert there == pytest.approx(followed("cpu", sets, arm=arm), abs=0.3)


def test_a_step_of_the_fit_waits_for_the_device_twice_and_sends_it_nothing() -> None:
    def traffic(steps: int) -> Traffic:
        with pretended() as counted:
            followed(NAME, sliding(1, rig(56, 42)), steps)
        return counted

    one, two = traffic(1), traffic(2)
    assert two.waits == one.waits + 2  # whether what is drawn, and what is compared, is finite
    assert two.sent == one.sent
