"""The arm's own Gaussians learn the sides that it turns to the cameras."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from model_scenes import camera, frames, with_joints

from twin_node.model import MapParameters, ModelParameters, SeedParameters, WindowModel
from twin_node.model.rays import back_project, look
from twin_node.model.robot_links import arm_depth
from twin_node.model.stages import granted
from twin_node.robot import forward_kinematics, place_capsules, robot_mask, ur_model
from twin_node.scene import Bool, Camera, Float64, FrameSet, Tier

ARM = ur_model("ur5e")
Q = np.array([0.3, -1.2, 1.4, -1.6, -1.5, 0.0])
HALF_ROUND = np.array([np.pi, 0, 0, 0, 0, 0])
CAMERA = camera("cam", (1.5, 0.3, 1.0), (0.0, 0, 0.3))


def chequered(index: int, q: Float64, depth: bool = True, seen_by: Camera = CAMERA) -> tuple[FrameSet, Bool]:
    """The table behind an arm with a pattern that turns with its first joint, and the arm's own pixels."""
    bare = with_joints(frames(index, None, (seen_by,), depth=True), ARM.joint_names, q)
    view = bare.views[0]
    reached = arm_depth(ARM, q, seen_by, robot_mask(ARM, q, seen_by, margin_m=0.0))
    on_arm = reached > 0
    points = back_project(seen_by, reached)
    ahead = points[..., 0] * np.cos(q[0]) + points[..., 1] * np.sin(q[0])
    aside = points[..., 1] * np.cos(q[0]) - points[..., 0] * np.sin(q[0])
    light = np.stack([np.where(ahead % 0.3 < 0.15, 220, 40), np.where(aside > 0, 230, 30), 128 + 0 * ahead], -1)
    rgb = np.where(on_arm[..., None], light.astype(np.uint8), view.rgb)
    assert view.depth is not None
    measured = np.where(on_arm, reached, view.depth) if depth else None
    return replace(bare, views=(replace(view, rgb=rgb, depth=measured),)), on_arm


def missed_on_the_arm(steps: int, depth: bool) -> tuple[float, int]:
    """Mean difference (0 to 1) on the arm when it has turned its back, and how many Gaussians it has."""
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=8), map=MapParameters(steps=steps)), arm=ARM)
    for index in range(16):
        one, on_arm = chequered(index, Q if index < 2 else Q + HALF_ROUND, depth)
        state = model.update(one)
    off = np.abs(model.render(CAMERA).rgb - one.views[0].rgb / np.float32(255)).mean(-1)
    return float(off[on_arm].mean()), int((state.gaussians.tiers == Tier.ROBOT).sum())


def test_sides_of_the_arm_that_no_camera_had_seen_are_learnt_when_it_turns() -> None:
    for depth in (True, False):
        learnt, count = missed_on_the_arm(1, depth)
        given, before = missed_on_the_arm(0, depth)
        assert learnt < 0.6 * given
        assert before < count < 4 * before


def test_an_arm_is_learnt_though_the_next_set_comes_as_soon_as_there_is_time() -> None:
    given, _ = missed_on_the_arm(0, True)
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=8)), arm=ARM)
    busy: list[str] = []
    model.on_stage = busy.append
    for index in range(10):
        one, on_arm = chequered(index, Q if index < 2 else Q + HALF_ROUND)
        model.update(one)
        busy.clear()
        model.refine(lambda: "bear" not in busy, least=4)
    off = np.abs(model.render(CAMERA).rgb - one.views[0].rgb / np.float32(255)).mean(-1)
    assert off[on_arm].mean() < 0.8 * given


def test_every_camera_teaches_the_arm_in_every_set() -> None:
    cameras = (CAMERA, camera("opposite", (-1.5, -0.3, 1.0), (0.0, 0, 0.3)))
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=8)), arm=ARM)
    for index in range(3):
        seen = [chequered(index, Q if index < 2 else Q + HALF_ROUND, seen_by=one) for one in cameras]
        views = tuple(one.views[0] for one, _ in seen)
        model.update(replace(seen[0][0], views=views))

    def missed() -> list[float]:
        off = [np.abs(model.render(view.camera).rgb - view.rgb / np.float32(255)).mean(-1) for view in views]
        return [float(one[on_arm].mean()) for one, (_, on_arm) in zip(off, seen, strict=True)]

    before = missed()
    model.refine()
    model.update(replace(seen[0][0], stamp=seen[0][0].stamp + 1, views=views))
    assert all(now < 0.98 * then for now, then in zip(missed(), before, strict=True))


@pytest.mark.parametrize(("width", "height"), [(1, 1), (80, 1)])
def test_images_one_pixel_across_teach_nothing_of_the_arm(width: int, height: int) -> None:
    """They ended in an error of OpenCV: the arm is looked at in blocks, of which such an image has none."""
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=1)), arm=ARM)
    narrow = camera("narrow", (1.5, 0.3, 1.0), (0.0, 0, 0.3), width, height)
    for index in range(3):
        state = model.update(chequered(index, Q, seen_by=narrow)[0])
        model.refine()
    (mask,) = state.robot_masks
    assert mask is not None and mask.any()


def test_an_arm_that_looks_as_it_did_is_given_nothing_more() -> None:
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=24)), arm=ARM)
    counts = [int((model.update(chequered(i, Q)[0]).gaussians.tiers == Tier.ROBOT).sum()) for i in range(30)]
    assert counts[-1] == counts[20]


def test_what_depth_shows_before_the_arm_takes_nothing_from_what_it_hides() -> None:
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=24)), arm=ARM)
    q = Q + HALF_ROUND * 0.02
    for index in range(16):
        one, on_arm = chequered(index, q if index % 2 else Q)
        (view,) = one.views
        post = np.zeros(on_arm.shape, bool)
        middle = int(np.median(on_arm.nonzero()[1]))
        post[:, middle - 3 : middle + 3] = index > 0
        assert view.depth is not None
        rgb, measured = np.where(post[..., None], np.uint8(20), view.rgb), np.where(post, np.float32(0.5), view.depth)
        cloud = model.update(replace(one, views=(replace(view, rgb=rgb, depth=measured),))).gaussians
        if index == 0:
            first = cloud.only(cloud.tiers == Tier.ROBOT)
            seen = look(CAMERA, first.means)
            hidden = first.ids[seen.inside & (np.abs(seen.columns - middle) < 3)]
    was, is_now = (one.opacities[np.isin(one.ids, hidden)] for one in (first, cloud))
    assert len(hidden) > 5
    assert is_now.mean() > 0.95 * was.mean()


def test_an_arm_that_stands_is_soon_left_as_it_is_to_the_bit() -> None:
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=24)), arm=ARM)
    looks = []
    for index in range(40):
        cloud = model.update(chequered(index, Q + 1e-4 * (index % 2))[0]).gaussians  # as encoders err
        own = cloud.only(cloud.tiers == Tier.ROBOT)
        looks.append((own.rgb.tobytes(), own.scales.tobytes(), own.opacities.tobytes()))
    assert len(set(looks[25:])) == 1
    assert looks[1] != looks[5]


def test_what_is_learnt_lies_beneath_the_surface_so_that_it_does_not_stand_out_over_the_outline() -> None:
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=8)), arm=ARM)
    first = model.update(chequered(0, Q)[0]).gaussians.ids
    for index in range(1, 16):
        one, on_arm = chequered(index, Q + HALF_ROUND)
        cloud = model.update(one).gaussians
    learnt = cloud.only((cloud.tiers == Tier.ROBOT) & ~np.isin(cloud.ids, first))
    seen = look(CAMERA, learnt.means)
    depth = one.views[0].depth
    assert depth is not None
    shown = seen.inside & on_arm[seen.rows, seen.columns]
    beneath = (seen.depth - depth[seen.rows, seen.columns])[shown]
    assert shown.sum() > 15
    assert np.median(beneath / learnt.scales[shown].mean(1)) > 0.5


def test_nothing_of_an_arm_that_turns_stands_out_over_its_outline() -> None:
    eyes = (CAMERA, camera("beside", (0.2, 1.5, 1.0), (0.0, 0, 0.3)))
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=24)), arm=ARM)
    for index in range(16):
        seen = [chequered(index, Q + HALF_ROUND * index / 24, seen_by=one) for one in eyes]
        views = tuple(one.views[0] for one, _ in seen)
        model.update(replace(seen[0][0], views=views))
        model.refine()
    for view, (_, on_arm) in zip(views, seen, strict=True):
        off = np.abs(model.render(view.camera).rgb - view.rgb / np.float32(255)).mean(-1)
        around = cv2.dilate(on_arm.astype(np.uint8), np.ones((9, 9), np.uint8)).astype(bool) & ~on_arm
        assert off[around].mean() < 0.05


def test_a_set_that_is_left_after_the_arm_teaches_nothing_once_what_stands_is_another() -> None:
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=8)), arm=ARM)
    for index in range(24):
        model.update(chequered(index, Q + HALF_ROUND * index / 24)[0])
        model.refine(granted((2, 100)[index % 2]))


def test_an_arm_that_no_camera_saw_at_first_is_learnt_when_it_comes_into_view() -> None:
    above = camera("cam", (0.75, 0.3, 0.6), (0.7, 0.1, 0.0))
    away, back = np.array([np.pi + 0.3, -1.2, 0.6, -1.6, -1.5, 0.0]), np.array([0.3, -0.9, 0.9, -1.6, -1.5, 0.0])
    assert not robot_mask(ARM, away, above).any()
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=2)), arm=ARM)
    for index in range(4):
        one = with_joints(frames(index, None, (above,)), ARM.joint_names, back if index else away)
        mask = robot_mask(ARM, back, above)
        grey = np.where(mask[..., None], np.uint8(190), one.views[0].rgb)
        cloud = model.update(replace(one, views=(replace(one.views[0], rgb=grey),)) if index else one).gaussians
    assert (cloud.tiers == Tier.ROBOT).any()


def test_what_is_learnt_of_the_arm_a_set_later_lies_where_the_arm_was_when_it_was_seen() -> None:
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=2)), arm=ARM)
    for index in range(3):
        model.update(chequered(index, Q)[0])
    known = model.update(chequered(3, Q + HALF_ROUND)[0]).gaussians.ids
    model.refine(granted(1))  # of its share the part that is the arm's is left over, and the arm goes on
    model.update(chequered(4, Q + 1.5 * HALF_ROUND)[0])
    model.refine()
    cloud = model.update(chequered(5, Q + 1.5 * HALF_ROUND)[0]).gaussians
    learnt = cloud.only((cloud.tiers == Tier.ROBOT) & ~np.isin(cloud.ids, known))
    assert len(learnt.ids) > 15
    placed = place_capsules(ARM, forward_kinematics(ARM, Q + 1.5 * HALF_ROUND))
    a, b = placed.ends[:, 0], placed.ends[:, 1]
    share = np.clip(((learnt.means[:, None] - a) * (b - a)).sum(-1) / ((b - a) ** 2).sum(1), 0, 1)
    apart = np.linalg.norm(learnt.means[:, None] - a - share[..., None] * (b - a), axis=-1) - placed.radii
    assert apart.min(1).max() < 0.02


@pytest.mark.parametrize(("leaves", "least", "most"), [(True, 0.0, 0.3), (False, 0.9, 1.0)])
def test_an_arm_that_left_while_nobody_told_of_its_joints_is_not_drawn_where_it_was(
    leaves: bool, least: float, most: float
) -> None:
    model = WindowModel(ModelParameters(seed=SeedParameters(steps=8), map=MapParameters(steps=0)), arm=ARM)
    counts = []
    for index in range(10):
        gone = leaves and index >= 2
        one, _ = chequered(index, Q + HALF_ROUND / 2 if gone else Q)
        stamp = one.stamp + 300_000_000 * index
        views = tuple(replace(view, stamp=stamp) for view in one.views)
        joints = None if index >= 2 or one.joints is None else replace(one.joints, stamp=stamp)
        model.update(replace(one, stamp=stamp, views=views, joints=joints))
        counts.append(model.tier_counts[Tier.ROBOT])
    assert least <= counts[-1] / counts[1] <= most
