"""Rays and voxels against signed distances, which are derived independently."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from twin_node.cell.shapes import Form, Placed, Shape, normals, ray_entries, touched_voxels
from twin_node.geometry import inverse_pose, pose, transform
from twin_node.scene import Grid

SHAPES = [Shape(Form.SPHERE, (0.2,)), Shape(Form.CAPSULE, (0.1, 0.5)), Shape(Form.BOX, (0.3, 0.2, 0.5))]
NAMES = [shape.form.value for shape in SHAPES]
seeds = st.integers(0, 2**32 - 1)


def signed_distance(shape: Shape, points: np.ndarray) -> np.ndarray:
    """Distance [n] of points [n, 3] in the shape's frame from its surface, negative inside."""
    if shape.form is Form.BOX:
        beyond = np.abs(points) - np.array(shape.size) / 2
        return np.linalg.norm(np.maximum(beyond, 0), axis=1) + np.minimum(beyond.max(axis=1), 0)
    half = shape.size[1] / 2 if shape.form is Form.CAPSULE else 0.0
    on_axis = np.zeros_like(points)
    on_axis[:, 2] = np.clip(points[:, 2], -half, half)
    return np.linalg.norm(points - on_axis, axis=1) - shape.size[0]


@pytest.mark.parametrize("shape", SHAPES, ids=NAMES)
@settings(max_examples=40, deadline=None)
@given(seed=seeds)
def test_rays_enter_at_the_first_surface_and_miss_only_what_they_pass(shape: Shape, seed: int) -> None:
    rng = np.random.default_rng(seed)
    origin = rng.normal(size=3)
    origin *= rng.uniform(1.0, 3.0) / np.linalg.norm(origin)
    directions = rng.normal(size=(3, 20)) * 0.25 - origin[:, None]
    entries = ray_entries(shape, origin.astype(np.float32), directions.astype(np.float32))
    for direction, entry in zip(directions.T, entries, strict=True):
        end = entry if np.isfinite(entry) else 3.0
        along = origin + np.linspace(0, end, 400)[:, None] * direction
        distances = signed_distance(shape, along)
        assert distances.min() > -2e-4
        if np.isfinite(entry):
            assert abs(distances[-1]) < 2e-4


@pytest.mark.parametrize("shape", SHAPES, ids=NAMES)
def test_normals_are_the_gradient_of_the_distance(shape: Shape) -> None:
    rng = np.random.default_rng(0)
    origin = np.array([1.3, -0.8, 0.6])
    directions = rng.normal(size=(3, 200)) * 0.1 - origin[:, None]
    entries = ray_entries(shape, origin.astype(np.float32), directions.astype(np.float32))
    hit = np.isfinite(entries)
    points = (origin[:, None] + entries * directions)[:, hit]
    facing = normals(shape, points.astype(np.float32))
    outside = signed_distance(shape, (points + 0.01 * facing).T)
    assert hit.sum() > 50
    assert np.abs(outside - 0.01).max() < 1e-4


def test_a_ray_from_inside_counts_as_a_miss() -> None:
    inside = np.zeros(3, np.float32)
    for shape in SHAPES:
        assert not np.isfinite(ray_entries(shape, inside, np.eye(3, dtype=np.float32))).any()


@pytest.mark.parametrize("shape", SHAPES, ids=NAMES)
@settings(max_examples=15, deadline=None)
@given(seed=seeds)
def test_touched_voxels_agree_with_dense_samples(shape: Shape, seed: int) -> None:
    rng = np.random.default_rng(seed)
    placed = Placed(shape, pose(Rotation.random(random_state=seed % 2**31).as_matrix(), rng.uniform(-0.2, 0.2, 3)))
    grid = Grid(np.full(3, -0.5), 0.1, (10, 10, 10))
    touched = np.zeros(grid.size, bool)
    indices = touched_voxels(placed, grid)
    assert np.all(np.diff(indices) > 0)
    touched[indices] = True

    steps = (np.arange(7) / 6 - 0.5) * grid.voxel_size
    inner = np.stack(np.meshgrid(steps, steps, steps, indexing="ij"), -1).reshape(1, -1, 3)
    samples = grid.centers(np.arange(grid.size))[:, None, :] + inner
    local = transform(inverse_pose(placed.T_base_shape), samples.reshape(-1, 3))
    nearest = signed_distance(shape, local).reshape(grid.size, -1).min(axis=1)
    between_samples = np.sqrt(3) / 2 * grid.voxel_size / 6
    assert touched[nearest <= 0].all()
    assert not touched[nearest > between_samples].any()


@pytest.mark.parametrize("shape", [Shape(Form.BOX, (0.5, 0.5, 0.5)), Shape(Form.SPHERE, (0.25,))])
def test_a_solid_that_ends_at_voxels_faces_touches_those_on_both_sides(shape: Shape) -> None:
    """Those below and before it were left out, as if it stood half a voxel farther up."""
    grid = Grid(np.zeros(3), 0.25, (8, 8, 8))
    touched = np.zeros(grid.dims, bool)
    touched.reshape(-1)[touched_voxels(Placed(shape, pose(np.eye(3), np.ones(3))), grid)] = True
    np.testing.assert_array_equal(touched, touched[::-1, ::-1, ::-1])
    assert touched[2, 3, 3] and touched[5, 3, 3] and not touched[1].any()


def test_a_solid_outside_the_grid_touches_nothing() -> None:
    grid = Grid(np.zeros(3), 0.1, (5, 5, 5))
    far = Placed(Shape(Form.SPHERE, (0.2,)), pose(np.eye(3), np.array([5.0, 0, 0])))
    assert len(touched_voxels(far, grid)) == 0
