"""Where the first set's pixels are put: planes, swept depth, measured depth, features."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from model_scenes import camera, frames, rig

from twin_node.geometry import project
from twin_node.model.features import triangulate
from twin_node.model.parameters import SeedParameters
from twin_node.model.plane import Plane, correlation, dominant_plane, plane_through
from twin_node.model.rays import back_project, look, pixel_rays
from twin_node.model.seeding import find_plane, find_surfaces, seed
from twin_node.model.sweep import shell_around

CAMERAS = rig(120, 90)
TABLE = Plane(np.array([0.0, 0.0, 1.0]), 0.0)


def test_the_table_is_found_from_colour_alone() -> None:
    views = frames(0, None, CAMERAS).views
    plane = dominant_plane(views, triangulate(views))
    assert plane is not None
    assert plane.normal[2] > np.cos(np.radians(6))
    assert abs(plane.height(np.zeros((1, 3)))[0]) < 0.03


def test_the_table_is_found_from_depth() -> None:
    plane = find_plane(frames(0, -0.15, CAMERAS, depth=True).views)
    assert plane is not None
    assert plane.normal[2] > np.cos(np.radians(3))
    assert abs(plane.height(np.zeros((1, 3)))[0]) < 0.03


def test_no_plane_is_claimed_where_images_share_nothing() -> None:
    rng = np.random.default_rng(0)
    views = [
        replace(view, rgb=rng.integers(0, 255, view.rgb.shape, dtype=np.uint8))
        for view in frames(0, None, CAMERAS).views
    ]
    assert dominant_plane(views, np.zeros((0, 3))) is None
    assert dominant_plane(views[:1], np.zeros((0, 3))) is None
    assert plane_through(rng.uniform(-1, 1, (2000, 3)), np.array([[0, 0, 3.0]])) is None


def test_images_agree_through_the_true_plane_and_not_through_another() -> None:
    a, b, _ = frames(0, None, CAMERAS).views
    true, off = correlation(a, b, TABLE), correlation(a, b, TABLE.shifted(0.15))
    assert np.nanmean(true) > 0.5
    assert np.nanmean(true) > np.nanmean(off) + 0.3


@given(st.floats(-0.3, 0.3), st.floats(-0.3, 0.3), st.floats(-0.5, 0.5))
@settings(max_examples=20)
def test_depth_of_a_plane_lies_on_it(tilt_x: float, tilt_y: float, height: float) -> None:
    normal = np.array([tilt_x, tilt_y, 1.0]) / np.linalg.norm([tilt_x, tilt_y, 1.0])
    plane = Plane(normal, -height)
    depth = plane.depth(CAMERAS[0])
    hit = np.isfinite(depth) & (depth > 0)
    points = back_project(CAMERAS[0], np.where(hit, depth, 1.0))[hit]
    assert np.abs(plane.height(points)).max(initial=0.0) < 1e-9


def test_most_swept_pixels_lie_where_they_should() -> None:
    views = frames(0, None, CAMERAS).views
    shell = shell_around(CAMERAS, 2.5)
    for view, surface in zip(views, find_surfaces(views, TABLE, SeedParameters()), strict=True):
        table = TABLE.depth(view.camera)
        points = back_project(view.camera, np.where(np.isfinite(table), table, 1.0))
        on_table = np.isfinite(table) & (np.abs(points[..., :2]).max(-1) < 0.6)
        error = np.abs(surface.depth - table)[on_table] / table[on_table]
        assert np.mean(error < 0.05) > 0.9
        assert (surface.depth > 0).all()
        assert (surface.depth <= shell.depth(view.camera) + 1e-6).all()


def test_measured_depth_is_taken_and_gaps_are_filled() -> None:
    views = frames(0, -0.15, CAMERAS, depth=True).views
    assert views[0].depth is not None
    holed = views[0].depth.copy()
    holed[10:20, 10:20] = 0
    surfaces = find_surfaces([replace(views[0], depth=holed), *views[1:]], TABLE, SeedParameters())
    known = holed > 0
    assert np.array_equal(surfaces[0].depth[known], holed[known].astype(np.float64))
    assert (surfaces[0].depth[~known] > 0).all()


def test_seeds_respect_the_capacity_and_the_arm() -> None:
    views = frames(0, None, CAMERAS).views
    arm = np.zeros((90, 120), np.float32)
    arm[20:60, 30:70] = 0.5
    born = seed(views, [arm, None, None], SeedParameters(), 900, torch.device("cpu")).born
    assert len(born.means) <= 900
    near = np.linalg.norm(born.means.numpy() - CAMERAS[0].T_base_cam[:3, 3], axis=1)
    assert (near < 0.65).sum() >= 20


def test_invalid_pixels_seed_nothing() -> None:
    view = frames(0, None, CAMERAS).views[0]
    born = seed(
        [replace(view, valid=np.zeros((90, 120), bool))], [None], SeedParameters(), 900, torch.device("cpu")
    ).born
    assert len(born.means) == 0


def test_triangulated_features_lie_on_the_table() -> None:
    near = [camera("a", (0.9, -0.1, 0.9), width=240, height=180), camera("b", (0.9, 0.1, 0.9), width=240, height=180)]
    points = triangulate(frames(0, None, near).views)
    assert len(points) >= 10
    assert np.median(np.abs(points[:, 2])) < 0.05


def test_a_camera_upside_down_finds_the_table_at_the_same_height() -> None:
    near = [camera("a", (0.9, -0.1, 0.9), width=240, height=180), camera("b", (0.9, 0.1, 0.9), width=240, height=180)]
    upright, turned = frames(0, None, near).views, frames(0, None, near).views[1]
    one, K = turned.camera, turned.camera.K.copy()
    K[:2, 2] = [one.width, one.height] - K[:2, 2]
    T = one.T_base_cam @ np.diag([-1.0, -1.0, 1.0, 1.0])
    turned = replace(turned, camera=replace(one, K=K, T_base_cam=T), rgb=turned.rgb[::-1, ::-1].copy())
    heights = [np.median(triangulate(views)[:, 2]) for views in (upright, (upright[0], turned))]
    assert heights[0] == pytest.approx(heights[1], abs=1e-3)


@given(st.integers(0, 79), st.integers(0, 59), st.floats(0.2, 5))
def test_a_pixel_s_ray_falls_back_into_the_pixel(column: int, row: int, depth: float) -> None:
    one = rig()[0]
    point = one.T_base_cam[:3, 3] + depth * pixel_rays(one)[row, column]
    assert project(one.K, one.viewmat, point[None])[0] == pytest.approx([column + 0.5, row + 0.5, depth], abs=1e-6)
    seen = look(one, point[None])
    assert (seen.columns[0], seen.rows[0], bool(seen.inside[0])) == (column, row, True)
