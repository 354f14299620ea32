"""The robot mask against casting a ray through every pixel."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from twin_node.geometry import looking_at
from twin_node.robot import RobotError, forward_kinematics, place_capsules, robot_mask, ur_model
from twin_node.scene import Camera

MODEL = ur_model("ur5e")


def camera_at(position: NDArray[np.float64], target: NDArray[np.float64], focal: float = 55.0) -> Camera:
    K = np.array([[focal, 0, 32.0], [0, focal, 20.0], [0, 0, 1.0]])
    return Camera("test", 64, 40, K, looking_at(position, target))


def cast(camera: Camera, q: NDArray[np.float64], margin: float) -> NDArray[np.bool_]:
    """True where the ray of a pixel's centre passes any of 60 spheres threaded on a capsule's axis."""
    placed = place_capsules(MODEL, forward_kinematics(MODEL, q))
    columns, rows = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
    K = camera.K
    rays = np.stack([(columns - K[0, 2]) / K[0, 0], (rows - K[1, 2]) / K[1, 1], np.ones_like(rows)], -1).reshape(-1, 3)
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    hit = np.zeros(len(rays), bool)
    for ends, radius in zip(placed.ends, placed.radii + margin, strict=True):
        beads = ends[0] + np.linspace(0, 1, 60)[:, None] * (ends[1] - ends[0])
        local = beads @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
        along = np.maximum(rays @ local.T, 0.0)
        gap_sq = (local**2).sum(1) - 2 * along * (rays @ local.T) + along**2
        hit |= (gap_sq <= radius**2).any(1)
    return hit.reshape(camera.height, camera.width)


@given(
    q=st.lists(st.floats(-3, 3), min_size=6, max_size=6).map(np.array),
    turn=st.floats(0, 6.28),
    distance=st.floats(1.2, 3.0),
    margin=st.floats(0.0, 0.1),
)
@settings(max_examples=25, deadline=None)
def test_mask_holds_every_pixel_that_a_ray_says_and_few_more(
    q: NDArray[np.float64], turn: float, distance: float, margin: float
) -> None:
    position = np.array([distance * np.cos(turn), distance * np.sin(turn), 0.9])
    camera = camera_at(position, np.array([0.0, 0.0, 0.4]))
    expected, mask = cast(camera, q, margin), robot_mask(MODEL, q, camera, margin)
    assert not (expected & ~mask).any()
    # Beyond the exact outline: polygons drawn around circles, half a pixel, and pixels that the outline only crosses.
    pixel_m = (distance + 1.0) / camera.K[0, 0]
    near_edge = cast(camera, q, margin + 1.5 * pixel_m)
    assert not (mask & ~near_edge).any()


@pytest.mark.parametrize("seed", range(12))
def test_a_wide_lens_near_the_arm_is_masked_out_to_its_corners(seed: int) -> None:
    """There spheres are ellipses, half again as long as they are wide."""
    rng = np.random.default_rng(seed)
    turn, q = rng.uniform(0, 6.28), rng.uniform(-3, 3, 6)
    position = np.array([1.3 * np.cos(turn), 1.3 * np.sin(turn), rng.uniform(0.2, 1.5)])
    camera = camera_at(position, np.array([*rng.uniform(-0.8, 0.8, 2), rng.uniform(-0.5, 1.0)]), focal=24.0)
    expected, mask = cast(camera, q, 0.08), robot_mask(MODEL, q, camera, 0.08)
    assert not (expected & ~mask).any()


@pytest.mark.parametrize("seed", [2, 6, 7, 9, 11, 12])
def test_a_camera_next_to_the_arm_is_masked_right_and_sees_past_it(seed: int) -> None:
    rng = np.random.default_rng(seed)
    q = rng.uniform(-2, 2, 6)
    placed = place_capsules(MODEL, forward_kinematics(MODEL, q))
    nearest, aside = 2 + seed % 8, rng.normal(size=3)
    middle = placed.ends[nearest].mean(axis=0)
    position = middle + (placed.radii[nearest] + 0.05) * aside / np.linalg.norm(aside)
    camera = camera_at(position, middle + rng.uniform(-0.4, 0.4, 3), focal=40.0)
    expected, mask = cast(camera, q, 0.02), robot_mask(MODEL, q, camera, 0.02)
    assert 0.05 < expected.mean() < 0.95
    assert not (expected & ~mask).any()
    assert not (mask & ~cast(camera, q, 0.02 + 0.5 / camera.K[0, 0])).any()


def test_a_camera_inside_the_grown_arm_sees_nothing_but_the_arm() -> None:
    """Even where it looks away from what it touches."""
    placed = place_capsules(MODEL, forward_kinematics(MODEL, np.zeros(6)))
    longest = int(np.linalg.norm(placed.ends[:, 1] - placed.ends[:, 0], axis=1).argmax())
    at = placed.ends[longest].mean(axis=0) + np.array([0.0, 0.0, placed.radii[longest] + 0.03])
    camera = camera_at(at, at + np.array([1.0, 0.01, 0.7]))
    assert robot_mask(MODEL, np.zeros(6), camera, 0.05).all()
    assert not robot_mask(MODEL, np.zeros(6), camera, 0.0).all()


def test_an_arm_behind_the_camera_is_not_seen() -> None:
    camera = camera_at(np.array([2.0, 0.0, 0.5]), np.array([4.0, 0.0, 0.5]))
    assert not robot_mask(MODEL, np.zeros(6), camera).any()


def test_calibration_error_grows_the_mask() -> None:
    sharp = camera_at(np.array([1.5, 0.5, 0.9]), np.array([0.2, 0.0, 0.4]))
    rough = Camera(sharp.name, sharp.width, sharp.height, sharp.K, sharp.T_base_cam, sigma_m=0.03)
    q = np.array([0.0, -1.2, 1.4, -1.7, -1.57, 0.0])
    small, large = robot_mask(MODEL, q, sharp, 0.0), robot_mask(MODEL, q, rough, 0.0)
    assert not (small & ~large).any()
    np.testing.assert_array_equal(large, robot_mask(MODEL, q, sharp, 0.06))


def test_joints_that_are_not_finite_are_refused() -> None:
    with pytest.raises(RobotError, match="finite"):
        robot_mask(MODEL, np.full(6, np.nan), camera_at(np.array([2.0, 0.0, 1.0]), np.zeros(3)))
