"""Rigid motions and projection against SciPy's rotations and plain arithmetic, many at a time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from twin_node.geometry import (
    cross,
    distance_to_segment,
    inverse_pose,
    looking_at,
    pose,
    project,
    quat_from_rotation,
    rotation_from_quat,
    transform,
)


def turns(seed: int, count: int = 7) -> Rotation:
    return Rotation.random(count, random_state=seed)


def w_first(rotations: Rotation) -> np.ndarray:
    return np.roll(rotations.as_quat(), 1, axis=-1)


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000), length=st.floats(1e-3, 1e3))
def test_quaternions_of_any_length_are_scipys_rotations(seed: int, length: float) -> None:
    lengths = np.geomspace(1, length, 7)[:, None]
    found = rotation_from_quat(lengths * w_first(turns(seed)))
    np.testing.assert_allclose(found, turns(seed).as_matrix(), atol=1e-12)
    np.testing.assert_allclose(rotation_from_quat(w_first(turns(seed))[3]), found[3], atol=1e-12)


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000))
def test_rotations_are_scipys_quaternions_with_a_real_part_that_is_not_negative(seed: int) -> None:
    quats, expected = quat_from_rotation(turns(seed).as_matrix()), w_first(turns(seed))
    assert (quats[:, 0] >= 0).all()
    np.testing.assert_allclose(np.abs((quats * expected).sum(axis=-1)), 1, atol=1e-12)


@pytest.mark.parametrize("axis", range(3))
def test_half_turns_have_quaternions_too(axis: int) -> None:
    half = Rotation.from_rotvec(np.pi * np.eye(3)[axis]).as_matrix()
    np.testing.assert_allclose(np.abs(quat_from_rotation(half)), np.eye(4)[axis + 1], atol=1e-9)


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000))
def test_a_motion_and_its_inverse_leave_points_where_they_are(seed: int) -> None:
    rng, rotations = np.random.default_rng(seed), turns(seed).as_matrix()
    motions = np.stack([pose(rotation, rng.normal(size=3)) for rotation in rotations])
    points = rng.normal(size=(5, 3))
    for motion, back in zip(motions, inverse_pose(motions), strict=True):
        np.testing.assert_allclose(transform(back, transform(motion, points)), points, atol=1e-12)
        np.testing.assert_allclose(motion @ back, np.eye(4), atol=1e-12)
    np.testing.assert_allclose(transform(motions[0], points), points @ rotations[0].T + motions[0, :3, 3])


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000), above=st.booleans())
@example(seed=7751, above=False)  # two degrees off straight down
def test_who_looks_at_a_point_has_it_straight_ahead_and_is_upright(seed: int, above: bool) -> None:
    rng = np.random.default_rng(seed)
    eye, target = rng.uniform(-2, 2, (2, 3))
    if above:
        target = eye - [0.0, 0.0, 1.5]
    T = looking_at(eye, target)
    distance = np.linalg.norm(target - eye)
    np.testing.assert_allclose(transform(inverse_pose(T), target[None])[0], [0, 0, distance], atol=1e-12)
    np.testing.assert_allclose(T[:3, :3].T @ T[:3, :3], np.eye(3), atol=1e-12)
    assert np.linalg.det(T[:3, :3]) > 0
    assert abs(T[2, 0]) < 1e-12  # the image's rows are level
    assert above or T[2, 1] < 0  # and its columns run down


def test_points_are_seen_where_similar_triangles_put_them() -> None:
    """A camera 2 m above the origin that looks down, its image's right along the base's x."""
    K = np.array([[100.0, 0, 40], [0, 200.0, 30], [0, 0, 1]])
    looks_down = inverse_pose(pose(np.diag([1.0, -1.0, -1.0]), np.array([0, 0, 2.0])))
    points = np.array([[0.0, 0, 0], [0.5, 0, 0], [0, 0.5, 1.0], [0, 0, 3.0], [0.5, 0, 2.0]])
    seen = project(K, looks_down, points)
    np.testing.assert_allclose(seen[:3], [[40, 30, 2], [65, 30, 2], [40, 30 - 100, 1]], atol=1e-12)
    assert seen[3, 2] == -1
    assert np.isfinite(seen).all()  # also beside the camera, where there is no pixel


@settings(max_examples=20)
@given(seed=st.integers(0, 10_000), length=st.floats(0, 2))
def test_a_segment_is_as_far_away_as_its_nearest_point(seed: int, length: float) -> None:
    rng = np.random.default_rng(seed)
    start, way = rng.normal(size=3), turns(seed, 1).apply(np.array([length, 0, 0]))[0]
    points = rng.normal(size=(2, 4, 3))
    along = start + np.linspace(0, 1, 2001)[:, None] * way
    expected = np.linalg.norm(points[..., None, :] - along, axis=-1).min(axis=-1)
    found = distance_to_segment(points, np.stack([start, start + way]))
    np.testing.assert_allclose(found, expected, atol=1e-3)
    assert (found <= expected + 1e-12).all()


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
@pytest.mark.parametrize(("first", "second"), [((3,), (3,)), ((5, 1, 3), (4, 3)), ((0, 3), (0, 3))])
def test_cross_products_are_numpys_to_the_bit(first: tuple[int, ...], second: tuple[int, ...], dtype: type) -> None:
    rng = np.random.default_rng(4)
    a, b = rng.normal(size=first).astype(dtype), rng.normal(size=second).astype(dtype)
    found = cross(a, b)
    assert found.dtype == dtype
    np.testing.assert_array_equal(found, np.cross(a, b))
