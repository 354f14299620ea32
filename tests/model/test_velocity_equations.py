"""What is compiled of the velocities of bodies is what is plain."""

from __future__ import annotations

import numpy as np

from twin_node.model.velocity_equations import (
    PARAMETERS,
    VelocityEquations,
    judge,
    judge_reference,
    velocities_of,
    velocities_reference,
)


def said_of(count: int) -> tuple[VelocityEquations, np.ndarray]:
    """Equations of bodies of which much, little and nothing was said, and points about which to tell them."""
    rng = np.random.default_rng(7)
    J = rng.normal(size=(count, 20, PARAMETERS)) * np.geomspace(1e-3, 1e3, count)[:, None, None]
    error = rng.normal(size=(count, 20, 1))
    J[-1], error[-1] = 0, 0
    H, g = np.swapaxes(J, 1, 2) @ J, (np.swapaxes(J, 1, 2) @ error)[..., 0]
    said = VelocityEquations(H, g, np.square(error).sum((1, 2)), np.full(count, 5.0))
    return said, np.broadcast_to(rng.normal(size=3), (count, 3))


def test_compiled_velocities_are_the_plain_ones() -> None:
    said, points = said_of(12)
    for name, found in vars(said.about(points)).items():
        assert np.allclose(found, vars(said.about_reference(points))[name], 1e-12, 1e-12)
    assert np.allclose(velocities_of(said, points), velocities_reference(said, points), 1e-7, 1e-9)


def test_bodies_are_judged_by_the_compiled_kernel_as_by_the_plain_one() -> None:
    said, points = said_of(12)
    for name, found in vars(judge(said, points)).items():
        assert np.allclose(found, vars(judge_reference(said, points))[name], 1e-7, 1e-7)


def test_nobody_is_judged_where_nothing_is_said_of_anybody() -> None:
    said, points = said_of(3)
    nobody = said.of(np.zeros(0, np.int64))
    for judged in (judge, judge_reference):
        assert len(judged(nobody, points[:0]).evidence) == 0
    for velocities in (velocities_of, velocities_reference):
        assert velocities(nobody, points[:0]).shape == (0, PARAMETERS)
