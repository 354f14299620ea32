"""The bundle's eliminations against plain dense least squares, where its unknowns stand, and which way clocks go."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from test_bundle_adjustment import a_moving_state, sightings_of

from twin_node.rig.calibrate.bundle import BoardFreedom, BundleOptions, Layout
from twin_node.rig.calibrate.bundle_equations import Change
from twin_node.rig.calibrate.bundle_problem import (
    CLOCK_SIGMA_S,
    RATE_SIGMA,
    READOUT_SIGMA_S,
    ROBUST_SIGMAS,
    SHEET_SIGMA,
    BundleProblem,
)
from twin_node.scene import Float64

JITTER_S = np.array([0.004, 0.006])


def test_delays_are_told_as_by_dense_least_squares() -> None:
    """Step and variance of what single stamps are off by, all else being free."""
    rng, state = np.random.default_rng(4), a_moving_state("plumb_bob", (0.01, -0.02))
    seen = sightings_of(state, rng, noise=0.3)[::3]
    state = replace(state, delays=rng.normal(0, 0.002, len(seen)), clocks=2 * state.clocks)
    problem = BundleProblem(state, seen, BundleOptions(lenses=False, board=BoardFreedom.SHEET))
    problem.jitter, noise = JITTER_S, np.array([0.3, 0.4])
    about = problem.look(state)
    equations = problem.equations(about, problem.seen, noise)
    inner, outer = (len(part) for part in equations.normal.slopes)
    square = (about.residuals**2).sum(-1) / noise[problem.camera, None] ** 2
    weights = (1 + square / ROBUST_SIGMAS**2) ** -0.25 / noise[problem.camera, None]

    def off(change: Float64) -> Float64:
        """What an unknown vector leaves over, in sigmas."""
        tried = problem.changed(state, Change(*np.split(change, [inner, inner + outer])))
        sheet = np.linalg.pinv(problem._sheet) @ (tried.points - state.points).ravel() / SHEET_SIGMA
        return np.concatenate(
            [
                (problem.look(tried).residuals * weights[..., None])[problem.seen].ravel(),
                problem.hands.roughness(tried.course).ravel(),
                (tried.clocks[1] / [CLOCK_SIGMA_S, RATE_SIGMA]),
                tried.readouts / READOUT_SIGMA_S,
                sheet,
                tried.delays / JITTER_S[problem.camera],
            ]
        )

    count = inner + outer + len(seen)
    J = np.stack([(off(step) - off(-step)) / 2e-6 for step in 1e-6 * np.eye(count)], axis=1)
    H = J.T @ J + 1e-6 * np.diag(np.arange(count) < inner)  # course that nothing tells is held
    expected = np.linalg.solve(H, -J.T @ off(np.zeros(count)))
    solution = equations.solution(0.0)
    sigmas = np.sqrt(np.diag(np.linalg.inv(H)))
    found = np.concatenate([solution.inner, solution.outer, solution.delays])
    assert np.abs((found - expected) / sigmas).max() < 0.02
    assert np.abs(expected / sigmas)[-len(seen) :].max() > 0.3
    np.testing.assert_allclose(np.sqrt(equations.delay_variances()), sigmas[-len(seen) :], rtol=2e-3)
    slopes = -J.T @ off(np.zeros(count))
    own = np.linalg.solve(H[inner + outer :, inner + outer :], slopes[inner + outer :])
    # What the delays gain with nothing else changed is no part of what is promised.
    gain = (slopes @ expected - slopes[inner + outer :] @ own) / 2
    assert equations.promise(solution) == pytest.approx(gain, rel=0.01)


def test_delays_that_are_fixed_have_no_variance() -> None:
    state = a_moving_state("plumb_bob")
    seen = sightings_of(state, np.random.default_rng(0))
    problem = BundleProblem(state, seen, BundleOptions(lenses=False))
    equations = problem.equations(problem.look(state), problem.seen, np.ones(2))
    np.testing.assert_array_equal(equations.delay_variances(), np.zeros(len(seen)))


def test_clocks_are_added_and_grow_from_where_they_hold() -> None:
    state = replace(a_moving_state("plumb_bob"), clocks=np.array([[0.0, 0.0], [0.5, 1e-3]]), reference_s=10.0)
    times = state.rig_times(np.array([0, 1, 1, 1]), np.array([7.0, 10.0, 110.0, -90.0]))
    np.testing.assert_allclose(times, [7.0, 10.5, 110.6, -89.6])


def test_every_unknown_has_a_place_of_its_own() -> None:
    layout = Layout(3, (9, 8, 9), clocks=True, readouts=True, shape=4)
    parts = [
        *(layout.camera(i) for i in range(3)),
        *(layout.lens(i) for i in range(3)),
        *(layout.clock(i) for i in range(3)),
        *(layout.readout(i) for i in range(3)),
        layout.board,
    ]
    sizes = [len(range(layout.size)[part]) for part in parts]
    assert sizes == [0, 6, 6, 9, 8, 9, 0, 2, 2, 1, 1, 1, 4]
    places = np.concatenate([np.arange(layout.size)[part] for part in parts])
    np.testing.assert_array_equal(places, np.arange(12 + 26 + 4 + 3 + 4))


def test_what_is_fixed_has_no_place() -> None:
    layout = Layout(2, (), clocks=False, readouts=False, shape=0)
    for i in range(2):
        for part in (layout.lens(i), layout.clock(i), layout.readout(i), layout.board):
            assert part.start == part.stop == 6
    assert layout.size == 6
