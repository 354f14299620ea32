"""What the compiled library finds where points fall and how nodes would have to move, held to numpy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from model_scenes import block, camera, frames, joined, rig, table
from test_steps import observe

from twin_node.geometry import project
from twin_node.model.backgrounds import look_at_spheres, pixels_reached
from twin_node.model.normal_equations import NormalEquations, linearise
from twin_node.model.points import MOTIONS, Carried, find_pixels, has_points
from twin_node.model.rays import look
from twin_node.model.rendering import render

pytestmark = pytest.mark.skipif(not has_points(), reason="the compiled library is not at hand")
CAMERAS = rig(120, 90)


@given(st.integers(0, 2**32 - 1), st.floats(0.01, 100))
def test_pixels_are_those_of_the_projection(seed: int, spread: float) -> None:
    one = camera("one", (1.0, -0.5, 0.8))
    points = np.random.default_rng(seed).normal(size=(50, 3)) * spread
    pixels = find_pixels(points, one.viewmat, one.K, one.width, one.height)
    uvz = project(one.K, one.viewmat, points)
    whole = np.floor(uvz[:, :2])
    clear = (np.abs(uvz[:, :2] - np.round(uvz[:, :2])) > 1e-6).all(1)
    inside = (whole >= 0).all(1) & (whole[:, 0] < one.width) & (whole[:, 1] < one.height) & (uvz[:, 2] > 0.02)
    assert np.array_equal(pixels.inside[clear], inside[clear])
    assert np.allclose(pixels.depths, uvz[:, 2])
    shown = inside & clear
    assert np.array_equal(np.stack([pixels.columns, pixels.rows], 1)[shown], whole[shown].astype(int))
    assert (pixels.columns >= 0).all() and (pixels.columns < one.width).all() and (pixels.rows < one.height).all()


@given(st.integers(0, 2**32 - 1), st.floats(0.01, 100))
def test_spheres_reach_into_the_image_as_far_as_numpy_says(seed: int, spread: float) -> None:
    one, generator = camera("one", (1.0, -0.5, 0.8)), np.random.default_rng(seed)
    points = generator.normal(size=(50, 3)) * spread
    radii = generator.uniform(0, spread, 50).astype(np.float32)
    spheres = look_at_spheres(one, points, radii)
    plain = pixels_reached(one, look(one, points), points, radii)
    clear = np.abs(plain) > 1e-2  # what just does not reach in by one rounding does by another
    assert np.array_equal(spheres.reach_px[clear] < 0, plain[clear] < 0)
    assert np.allclose(spheres.reach_px[clear], plain[clear], rtol=1e-4)
    assert np.array_equal(spheres.middles.inside, look(one, points).inside)


@pytest.mark.parametrize("depth", [False, True])
def test_equations_are_those_of_numpy(depth: bool) -> None:
    observed = observe(table(), 0.12, depth)
    moving = block(0.1)
    shown = render(joined(table(), moving), CAMERAS)
    generator = np.random.default_rng(4)
    means = moving.means[0].double().numpy()
    nodes = generator.integers(0, 2, len(means))
    carried = Carried(means, means - [0.1, 0, 0.05], generator.uniform(0.2, 1, len(means)), nodes)
    plain, compiled = NormalEquations(2), NormalEquations(2)
    for one, rendering in zip(observed, shown, strict=True):
        flow = generator.normal(0, 1.5, (*one.usable.shape, 2)).astype(np.float32)
        plain.add(linearise(one, rendering, flow, carried), 2.0)
        compiled.add_view(carried, one, rendering, flow, 2.0)
    assert plain.sums.weights.min() > 5
    for name, values in vars(plain.sums).items():
        assert np.allclose(values, getattr(compiled.sums, name), rtol=2e-2, atol=1e-4 * np.abs(values).max()), name


def test_a_camera_that_sees_nothing_adds_nothing() -> None:
    one = observe(table(), 0.12)[0]
    blind = replace(one, near_moving=np.zeros_like(one.near_moving))
    rendering = render(table(), CAMERAS[:1])[0]
    carried = Carried(np.zeros((3, 3)), np.zeros((3, 3)), np.ones(3), np.zeros(3, np.int64))
    equations = NormalEquations(1)
    equations.add_view(carried, blind, rendering, np.zeros((90, 120, 2), np.float32), 1.0)
    assert not equations.sums.H.any() and not equations.count.any()
    assert len(frames(0, None, CAMERAS).views) == len(CAMERAS)


@given(st.integers(0, 2**32 - 1))
def test_compiled_motions_are_those_of_numpy(seed: int) -> None:
    """Of nodes of which much, little and nothing is seen."""
    generator = np.random.default_rng(seed)
    equations = NormalEquations(6)
    J = generator.normal(size=(6, 40, MOTIONS)) * np.geomspace(1e-2, 1e4, 6)[:, None, None]
    error = generator.normal(size=(6, 40, 1))
    J[2] = 0
    own = equations.sums
    own.H[:], own.g[:] = np.swapaxes(J, 1, 2) @ J, (np.swapaxes(J, 1, 2) @ error)[..., 0]
    own.squares[:], own.weights[:] = np.square(error).sum((1, 2)), (3, 1, 0, 5, 0.1, 7)
    for size in (6, MOTIONS):
        sigmas = np.geomspace(1e-3, 1, size)
        solved, plain = equations.solve(size, sigmas), equations.solve_reference(size, sigmas)
        for name, values in vars(plain).items():
            assert np.allclose(vars(solved)[name], values, 1e-6, 1e-12), name
        assert not solved.solution[2].any()
