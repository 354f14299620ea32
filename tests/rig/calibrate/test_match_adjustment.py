"""The adjustment's derivatives against differences, through every lens, on and off the plane."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.optimize import approx_fprime

from twin_node.geometry import inverse_pose, looking_at, transform
from twin_node.rig.calibrate.lenses import raw_pixels
from twin_node.rig.calibrate.match_adjustment import MatchProblem
from twin_node.rig.calibrate.matches import Matches
from twin_node.scene import RigCamera

LENSES = {
    "plumb_bob": np.array([-0.1, 0.05, 0.002, -0.001, 0.01]),
    "rational_polynomial": np.array([0.3, 0.1, 0.001, 0.001, 0.01, 0.5, 0.1, 0.02]),
    "equidistant": np.array([-0.03, 0.01, 0.002, 0.0]),
}
ABOVE_HORIZON = (240.0, 20.0)
"""Where the lowest camera sees no plane."""


def looking_down(name: str, eye: tuple[float, float, float], model: str) -> RigCamera:
    T = looking_at(eye, [0.5, 0.1, 0.0])
    K = np.array([[400.0, 0, 239.5], [0, 405.0, 179.5], [0, 0, 1]])
    return RigCamera(name, 480, 360, K, T, model, LENSES[model])


@pytest.mark.parametrize("model", LENSES)
@pytest.mark.parametrize("with_plane", [True, False])
def test_derivatives_are_those_of_the_residuals(model: str, with_plane: bool) -> None:
    rng = np.random.default_rng(0)
    eyes = ((1.1, 0.2, 0.15), (-0.2, 0.4, 0.7), (0.4, -0.8, 0.9))
    cameras = tuple(looking_down(f"cam_{i}", eye, model) for i, eye in enumerate(eyes))
    plane = np.array([0.01, -0.02, 1.0, 0.0])
    plane[:3] /= np.linalg.norm(plane[:3])
    matches = []
    for a, b, on_plane in ((0, 1, True), (2, 1, True), (0, 2, False)):
        points = rng.uniform([0.2, -0.2, 0.0], [0.8, 0.4, 0.0 if on_plane else 0.3], (9, 3))
        seen = [raw_pixels(cameras[i], transform(inverse_pose(cameras[i].T_base_cam), points)) for i in (a, b)]
        noisy = [pixels + rng.normal(0, 0.5, pixels.shape) for pixels in seen]
        noisy[0][0] = ABOVE_HORIZON
        matches.append(Matches(a, b, noisy[0], noisy[1], on_plane))
    problem = MatchProblem(cameras, plane if with_plane else None, matches)
    for x in (np.zeros(problem.size), rng.normal(0, 0.5, problem.size)):
        numeric = approx_fprime(x, problem.residuals, 1e-6)
        exact = problem.jacobian(x)
        assert exact.shape == numeric.shape
        np.testing.assert_allclose(exact, numeric, rtol=1e-3, atol=1e-3)
