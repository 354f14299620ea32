"""Which pixels show the arm, by what depth measures there; and which of its capsules is nearest."""

from __future__ import annotations

import dataclasses

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from twin_node.geometry import looking_at
from twin_node.model.arm_mask import cut_out, off_arm, off_arm_reference, robot_masks, shown_arms
from twin_node.model.capsules import nearest_capsules, nearest_reference
from twin_node.model.kernels import kernels
from twin_node.model.robot_links import arm_depth
from twin_node.robot import robot_mask, robot_outline, ur_model
from twin_node.scene import Bool, Camera, Float32, Float64, FrameSet, JointSample, View

MODEL = ur_model("ur5e")
K_OFF = np.array([[0, 0, 48.0], [0, 0, 36.0], [0, 0, 0]])
"""Principal point of a second camera, px."""


def camera_at(position: NDArray[np.float64], target: NDArray[np.float64], focal: float = 55.0) -> Camera:
    K = np.array([[focal, 0, 32.0], [0, focal, 20.0], [0, 0, 1.0]])
    return Camera("test", 64, 40, K, looking_at(position, target))


def mask_of(camera: Camera, q: NDArray[np.float64], depth: Float32) -> Bool:
    view = View(camera, 0, np.zeros((*depth.shape, 3), np.uint8), depth)
    return shown_arms([robot_outline(MODEL, q, camera)], [view])[0]


def seen_by_depth(camera: Camera, q: NDArray[np.float64], wall_m: float) -> tuple[NDArray[np.bool_], Float32]:
    """The arm's grown mask, and the depth of the arm before a wall that is only measured there."""
    mask = robot_mask(MODEL, q, camera)
    surface = arm_depth(MODEL, q, camera, mask)
    return mask, np.where(surface > 0, surface, np.where(mask, wall_m, 0)).astype(np.float32)


@pytest.mark.parametrize(("row", "column"), [(24, 31), (27, 34)])
def test_what_depth_shows_in_front_of_the_arm_is_not_the_arm(row: int, column: int) -> None:
    """Before the wrist; and before the base, where the wrist is nearer to the camera than the hand is."""
    camera = camera_at(np.array([1.5, 0.5, 0.9]), np.array([0.2, 0.0, 0.4]))
    q = np.array([0.0, -1.2, 1.4, -1.7, -1.57, 0.0])
    _, surface = seen_by_depth(camera, q, wall_m=0.0)
    mask = mask_of(camera, q, surface)
    hand = np.s_[row - 2 : row + 3, column - 2 : column + 3]
    held_up = surface.copy()
    held_up[hand] = surface[row, column] - 0.25
    expected = mask.copy()
    expected[hand] = False
    np.testing.assert_array_equal(mask_of(camera, q, held_up), expected)


def test_what_depth_shows_past_the_arm_is_not_the_arm_but_for_its_edge() -> None:
    camera = camera_at(np.array([1.5, 0.5, 0.9]), np.array([0.2, 0.0, 0.4]), focal=110.0)
    q = np.array([0.0, -1.2, 1.4, -1.7, -1.57, 0.0])
    grown, surface = seen_by_depth(camera, q, wall_m=3.0)
    arm = (surface > 0) & (surface < 2.9)
    edge = cv2.dilate(arm.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0
    for error in (-0.02, 0.0, 0.02):
        mask = mask_of(camera, q, np.where(surface > 0, surface + np.float32(error), 0))
        assert (mask & edge)[grown].sum() == (edge & grown).sum(), "the arm and its edge stay its own"
        assert not (mask & grown & ~edge).any(), "the wall beside it is seen"
    unmeasured = mask_of(camera, q, np.where(arm, surface, 0))
    np.testing.assert_array_equal(unmeasured, grown)


def test_every_camera_shows_the_arm_where_it_was_at_that_cameras_time() -> None:
    """Cameras that run freely are up to a period apart: at 1 m/s 3 cm at 30 Hz."""
    camera = camera_at(np.array([1.5, 0.5, 0.9]), np.array([0.2, 0.0, 0.4]))
    q, speeds = np.array([0.0, -1.2, 1.4, -1.7, -1.57, 0.0]), np.array([1.5, 0.3, 0, 0, 0, 0])
    stamps = (0, 20_000_000, 33_000_000)
    views = tuple(View(camera, stamp, np.zeros((40, 64, 3), np.uint8), None) for stamp in stamps)
    joints = JointSample(stamps[-1], MODEL.joint_names, q, speeds)
    masks = robot_masks(MODEL, FrameSet(stamps[-1], views, joints))
    for stamp, mask in zip(stamps, masks, strict=True):
        assert mask is not None
        then = q - speeds * (stamps[-1] - stamp) * 1e-9
        np.testing.assert_array_equal(mask, robot_mask(MODEL, then, camera))
    assert masks[0] is not None
    assert not np.array_equal(masks[0], robot_mask(MODEL, q, camera))


def capsules_and_points(rng: np.random.Generator, capsules: int, points: int) -> tuple[Float64, Float64, Float64]:
    """Ends [C, 2, 3] and radii [C], a third of them balls, and points [3, n], some within and some at an end."""
    ends = rng.normal(size=(capsules, 2, 3))
    ends[::3, 1] = ends[::3, 0]
    at = rng.normal(size=(3, points))
    at[:, : points // 4] = ends[rng.integers(capsules, size=points // 4), 0].T
    return ends, rng.uniform(0.01, 0.5, capsules), at


@given(seed=st.integers(0, 2**32 - 1), capsules=st.integers(1, 12), points=st.sampled_from([0, 1, 7, 256, 300, 1000]))
@settings(max_examples=30)
def test_the_nearest_capsule_is_that_of_which_some_ball_is_nearest(seed: int, capsules: int, points: int) -> None:
    ends, radii, at = capsules_and_points(np.random.default_rng(seed), capsules, points)
    shares = np.linspace(0, 1, 400)[:, None, None]
    beads = ends[:, 0] + shares * (ends[:, 1] - ends[:, 0])
    by_bead = (np.linalg.norm(beads[..., None] - at, axis=2) - radii[:, None]).min(0)
    for found in (nearest_reference(ends, radii, at), nearest_capsules(ends, radii, at)):
        bead_m = 1e-9 + 0.5 / 399 * np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1).max()
        assert (found.gaps <= by_bead.min(0) + 1e-9).all()
        assert (found.gaps >= by_bead.min(0) - bead_m).all()
        own = by_bead[found.capsules, np.arange(points)]
        np.testing.assert_allclose(own, found.gaps, atol=bead_m)
        nearest = ends[found.capsules]
        feet = nearest[:, 0] + found.shares[:, None] * (nearest[:, 1] - nearest[:, 0])
        np.testing.assert_allclose(np.linalg.norm(at.T - feet, axis=1) - radii[found.capsules], found.gaps)


@pytest.mark.skipif(kernels() is None, reason="no C++ compiler")
def test_compiled_and_plain_find_the_same() -> None:
    ends, radii, at = capsules_and_points(np.random.default_rng(3), 10, 5000)
    found, expected = nearest_capsules(ends, radii, at), nearest_reference(ends, radii, at)
    np.testing.assert_array_equal(found.capsules, expected.capsules)
    np.testing.assert_allclose(found.gaps, expected.gaps, atol=1e-12)
    np.testing.assert_allclose(found.shares, expected.shares, atol=1e-12)


@pytest.mark.skipif(kernels() is None, reason="no C++ compiler")
def test_compiled_and_plain_tell_the_same_of_the_arms_pixels() -> None:
    """Two views of other sizes, of which some pixels measure the arm, some what is before it or past it."""
    rng, q = np.random.default_rng(4), np.array([0.0, -1.2, 1.4, -1.7, -1.57, 0.0])
    cameras = [camera_at(np.array([1.5, 0.5, 0.9]), np.array([0.2, 0.0, 0.4]))]
    cameras.append(dataclasses.replace(cameras[0], width=97, height=73, K=np.diag([80.0, 80.0, 1.0]) + K_OFF))
    cuts = []
    for camera in cameras:
        outline = robot_outline(MODEL, q, camera)
        shape = outline.mask.shape
        surface = arm_depth(MODEL, q, camera, outline.mask)
        depth = surface + rng.choice([0.0, -0.3, 0.3, 2.0], shape) * rng.random(shape)
        measured = np.where(rng.random(shape) < 0.1, 0, np.maximum(depth, 0)).astype(np.float32)
        cuts.append(cut_out(outline, View(camera, 0, np.zeros((*shape, 3), np.uint8), measured)))
        assert cuts[-1].mask.sum() == outline.mask.sum() and cuts[-1].mask.size < outline.mask.size
    for found, cut in zip(off_arm(cuts), cuts, strict=True):
        expected = off_arm_reference(cut)
        assert 0 < found.before.sum() < cut.mask.sum() / 2
        assert (found.past.astype(bool) & cut.mask).any()
        np.testing.assert_array_equal(found.before, expected.before)
        np.testing.assert_array_equal(found.past, expected.past)
