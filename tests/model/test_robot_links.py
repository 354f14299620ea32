"""Gaussians on the arm follow its joints."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from model_scenes import camera, frames, with_joints

from twin_node.model import MapParameters, ModelError, ModelParameters, SeedParameters, WindowModel
from twin_node.model.gaussians import Gaussians, Newborns
from twin_node.model.nodes import Nodes
from twin_node.model.robot_links import RobotLinks, arm_depth, links_of
from twin_node.robot import forward_kinematics, place_capsules, robot_mask, ur_model
from twin_node.scene import Camera, Float64, FrameSet, JointSample, Tier

ARM = ur_model("ur5e")
Q = np.array([0.3, -1.2, 1.4, -1.6, -1.5, 0.0])
CAMERAS = tuple(camera(f"cam{i}", eye, (0.2, 0, 0.3)) for i, eye in enumerate([(1.6, -0.6, 1.0), (1.5, 0.7, 1.1)]))


def test_depth_of_the_arm_lies_on_its_capsules() -> None:
    mask = robot_mask(ARM, Q, CAMERAS[0], margin_m=0.0)
    depth = arm_depth(ARM, Q, CAMERAS[0], mask)
    assert (depth[~mask] == 0).all()
    assert (depth[mask] > 0).mean() > 0.7  # the mask is a pixel wider than the arm
    nearest = np.linalg.norm(
        place_capsules(ARM, forward_kinematics(ARM, Q)).ends.reshape(-1, 3) - CAMERAS[0].T_base_cam[:3, 3], axis=1
    ).min()
    assert depth[depth > 0].min() > nearest - 0.3


def test_robot_gaussians_move_with_the_joints_and_are_no_nodes_to_forecast() -> None:
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=8), gaussians_per_pixel=0.5), arm=ARM)
    first = model.update(with_joints(frames(0, None, CAMERAS), ARM.joint_names, Q))
    own = first.gaussians.tiers == Tier.ROBOT
    assert own.sum() > 30
    assert len(first.nodes.ids) == 0
    assert (first.gaussians.nodes[own] == -1).all()
    turned = Q + np.array([0.4, 0, 0, 0, 0, 0])
    second = model.update(with_joints(frames(1, None, CAMERAS), ARM.joint_names, turned))
    both = np.intersect1d(first.gaussians.ids[own], second.gaussians.ids)
    before = first.gaussians.means[np.isin(first.gaussians.ids, both)]
    after = second.gaussians.means[np.isin(second.gaussians.ids, both)]
    R = np.array([[np.cos(0.4), -np.sin(0.4), 0], [np.sin(0.4), np.cos(0.4), 0], [0, 0, 1]])
    base = np.abs(after - before).max(1) < 1e-4
    assert (~base).sum() > 20
    assert np.allclose(after[~base], before[~base] @ R.T, atol=1e-3)
    assert np.linalg.norm(second.gaussians.velocities[second.gaussians.tiers == Tier.ROBOT], axis=1).max() > 0.5


def test_an_arm_that_tells_its_joints_rarely_is_where_it_is_by_now() -> None:
    """At 10 Hz the newest are up to 0.1 s old: moved on at their velocities the arm is as if it had told them."""
    parameters = ModelParameters(seed=SeedParameters(steps=2), gaussians_per_pixel=0.2, map=MapParameters(steps=0))
    fresh, late = (WindowModel(parameters, arm=ARM) for _ in range(2))
    speeds, ago_s = np.array([1.0, 0, 0, 0, 0, 0]), 0.09
    for index in range(3):
        known = with_joints(frames(index, None, CAMERAS), ARM.joint_names, Q + 0.033 * index * speeds)
        assert known.joints is not None
        told = replace(known.joints, velocities=speeds)
        old = replace(told, stamp=told.stamp - int(ago_s * 1e9), positions=told.positions - ago_s * speeds)
        here, there = (
            model.update(replace(known, joints=joints)).gaussians for model, joints in ((fresh, told), (late, old))
        )
        own = here.tiers == Tier.ROBOT
        assert own.any()
        np.testing.assert_allclose(there.means[there.tiers == Tier.ROBOT], here.means[own], atol=1e-4)


def test_the_arm_is_as_fast_as_its_joints_turn_and_stands_while_nobody_tells_of_them() -> None:
    parameters = ModelParameters(seed=SeedParameters(steps=2), gaussians_per_pixel=0.2, map=MapParameters(steps=0))
    model, told = WindowModel(parameters, arm=ARM), []
    for index in range(8):
        bare = frames(index, None, CAMERAS)
        known = with_joints(bare, ARM.joint_names, Q + np.array([0.033 * index, 0, 0, 0, 0, 0]))
        cloud = model.update(bare if index in (4, 5) else known).gaussians
        told.append(cloud.only(cloud.tiers == Tier.ROBOT))
    for index in (1, 2, 3, 6, 7):
        about_z = np.cross([0.0, 0.0, 1.0], told[index].means)
        turning = np.linalg.norm(about_z, axis=1) > 0.15  # not the base
        assert np.linalg.norm(told[index].velocities - about_z, axis=1)[turning].max() < 0.04  # a mean over the step
    for index in (4, 5):
        assert (told[index].velocities == 0).all()
        assert np.array_equal(told[index].means, told[3].means)


def test_an_arm_whose_joints_are_told_later_goes_with_them_from_then_on() -> None:
    parameters = ModelParameters(seed=SeedParameters(steps=8), gaussians_per_pixel=0.5)
    models = [WindowModel(parameters, arm=ARM) for _ in range(2)]
    for index in range(8):
        known = with_arm(index, Q + np.array([0.2 * max(index - 3, 0), 0, 0, 0, 0, 0]))
        always = models[0].update(known).gaussians
        late = models[1].update(replace(known, joints=None) if index < 2 else known).gaussians
        count = int((late.tiers == Tier.ROBOT).sum())
        assert (count > 0.8 * (always.tiers == Tier.ROBOT).sum()) == (index >= 2)
        assert index > 2 or np.allclose(late.velocities[late.tiers == Tier.ROBOT], 0, atol=1e-9)
    view = known.views[0]
    on_arm = robot_mask(ARM, Q + np.array([0.8, 0, 0, 0, 0, 0]), view.camera, margin_m=0.0)
    missed = [np.abs(m.render(view.camera).rgb - view.rgb / np.float32(255)).mean(-1)[on_arm].mean() for m in models]
    assert missed[1] < 1.2 * missed[0]


def test_an_arm_waits_for_nodes_and_is_never_given_too_few() -> None:
    few = ModelParameters(seed=SeedParameters(steps=2), gaussians_per_pixel=0.2, nodes=len(links_of(ARM)))
    with pytest.raises(ModelError, match="one for each link"):
        WindowModel(replace(few, nodes=few.nodes - 1), arm=ARM)
    model, place = WindowModel(few, arm=ARM), torch.zeros(3, dtype=torch.float64)
    model.update(replace(with_arm(0, Q), joints=None))
    taken = model._nodes.give_birth(place, place)
    assert not (model.update(with_arm(1, Q)).gaussians.tiers == Tier.ROBOT).any()
    model._nodes.retire(torch.tensor([taken]))
    assert (model.update(with_arm(2, Q)).gaussians.tiers == Tier.ROBOT).any()


def test_room_is_made_for_what_moves_beside_the_arm() -> None:
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=2), gaussians_per_pixel=0.2), arm=ARM)
    model.update(with_arm(0, Q))
    model.update(with_arm(1, Q))
    assert model._begun is not None
    store, wanted = model._gaussians, 12
    for tier, count in ((Tier.TRANSIENT, 20), (Tier.STATIC, store.capacity)):  # there is no row left
        parts = (torch.rand(count, width) for width in (3, 4, 3))
        nobody = torch.full((count,), -1)
        store.spawn(Newborns(*parts, torch.rand(count), torch.rand(count, 3), tier, nobody), 0)
    assert store.count(Tier.ROBOT) > wanted
    model._begun.tracker._population._make_room(wanted)
    assert int((~store.alive).sum()) >= wanted


def test_the_arm_is_left_out_of_the_masks() -> None:
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=5), gaussians_per_pixel=0.5), arm=ARM)
    for index in range(3):
        state = model.update(with_joints(frames(index, None, CAMERAS), ARM.joint_names, Q + 0.1 * index))
    for moving, robot in zip(state.moving_masks, state.robot_masks, strict=True):
        assert robot is not None
        assert not (moving & robot).any()
    assert torch.isfinite(torch.from_numpy(state.gaussians.means)).all()


def with_arm(index: int, q: Float64) -> FrameSet:
    """The table with measured depth as one camera sees it, and a light grey arm before it."""
    bare = with_joints(frames(index, None, CAMERAS[:1], depth=True), ARM.joint_names, q)
    view = bare.views[0]
    mask = robot_mask(ARM, q, view.camera, margin_m=0.0)
    assert view.depth is not None
    depth = np.where(mask, arm_depth(ARM, q, view.camera, mask), view.depth)
    return replace(bare, views=(replace(view, rgb=np.where(mask[..., None], np.uint8(190), view.rgb), depth=depth),))


def errors_behind_and_beside(steps: int) -> tuple[float, float]:
    """Mean error of the ground where the arm was first, and of all other ground, after a first fit of some steps."""
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=steps)), arm=ARM)
    turned = Q + np.array([1.2, 0, 0, 0, 0, 0])
    for index in range(40):
        state = model.update(with_arm(index, Q if index < 2 else turned))
    view, robot = state.frames.views[0], state.robot_masks[0]
    assert robot is not None
    ground = ~robot & (view.rgb.max(-1) > 60)
    behind = robot_mask(ARM, Q, view.camera) & ground
    assert behind.sum() > 50
    missed = np.abs(model.render(view.camera).rgb - view.rgb / np.float32(255)).mean(-1)
    return float(missed[behind].mean()), float(missed[ground & ~behind].mean())


def test_what_stood_behind_the_arm_is_learnt_when_the_arm_has_left() -> None:
    """Single starts differ by a third; their mean does not."""
    behind, beside = np.mean([errors_behind_and_beside(steps) for steps in (100, 110, 120, 130)], axis=0)
    assert behind < 0.075
    assert beside < 0.02


@pytest.mark.parametrize(("narrowed", "hidden"), [(1, [1, 1, 0]), (2, [1, 1, 1])])
def test_what_no_camera_sees_beside_the_arm_is_the_arm_s_though_it_lies_off_it(
    narrowed: int, hidden: list[int]
) -> None:
    """A hand-eye pose 5 mm off left a Gaussian of the arm's rim standing 4 cm beside it: it held the arm for good. So
    did one 6 cm beside it where pixels are 4 cm each, as those of the least model are."""
    nodes, sample = Nodes(16, 8), JointSample(0, ARM.joint_names, Q, np.zeros(6))
    links = RobotLinks(ARM, nodes, sample)
    placed = place_capsules(ARM, forward_kinematics(ARM, Q))
    (begin, end), radius = placed.ends[3], placed.radii[3]
    across = np.cross(end - begin, CAMERAS[0].T_base_cam[:3, 3] - begin)
    across /= np.linalg.norm(across)
    means = (begin + end) / 2 + np.outer(radius + np.array([0.02, 0.045, 0.07]), across)
    cameras = [narrow(camera, narrowed) for camera in CAMERAS]
    everywhere = np.ones((cameras[0].height, cameras[0].width), bool)
    for masks, expected in (([everywhere, everywhere], hidden), ([everywhere, ~everywhere], [1, 0, 0])):
        gaussians, count = Gaussians(8, torch.device("cpu")), len(means)
        parts = (torch.from_numpy(means).float(), torch.eye(4)[[0] * count], torch.full((count, 3), 0.01))
        shown = (torch.full((count,), 0.9), torch.rand(count, 3), Tier.STATIC, torch.full((count,), -1))
        gaussians.spawn(Newborns(*parts, *shown), 0)
        links.bind(gaussians, sample, masks, cameras)
        assert (gaussians.tiers[:count] == Tier.ROBOT).int().tolist() == expected


def narrow(camera: Camera, times: int) -> Camera:
    """The camera with so many times fewer pixels each way."""
    K = camera.K / times
    K[2, 2] = 1
    return replace(camera, width=camera.width // times, height=camera.height // times, K=K)


def test_what_lies_too_near_the_surface_of_a_link_sinks_into_it() -> None:
    nodes = Nodes(16, 8)
    sample = JointSample(0, ARM.joint_names, Q, np.zeros(6))
    links = RobotLinks(ARM, nodes, sample)
    capsules, rows = ARM.capsules, nodes.alive.nonzero()[:, 0].numpy()
    one = int(np.flatnonzero(capsules.links == links_of(ARM)[1])[0])
    (begin, end), radius = capsules.ends[one], capsules.radii[one]
    across = np.cross(end - begin, [0.3, 0.5, 0.8])
    across /= np.linalg.norm(across)
    middle = (begin + end) / 2
    points = middle + across * (radius * np.array([0.2, 0.99, 1.5, 0.5]))[:, None]
    depths = np.array([0.1, 0.1, 0.1, 2.0]) * radius
    sunk = links.beneath(np.full(4, rows[1]), points, depths)
    assert np.allclose((sunk - middle) @ across / radius, [0.2, 0.9, 0.9, 0.0], atol=1e-6)
    assert np.allclose(np.linalg.norm(sunk - middle, axis=1) / radius, [0.2, 0.9, 0.9, 0.0], atol=1e-6)
