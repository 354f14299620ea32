"""Quaternion operations against the matrices that they stand for."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from hypothesis import given
from hypothesis import strategies as st

from twin_node.geometry import rotation_from_quat
from twin_node.model.rotations import (
    conjugate,
    quat_between,
    quat_from_vector,
    quat_product,
    rotate,
    vector_from_quat,
)

component = st.floats(-1, 1)
vectors = st.tuples(component, component, component).map(lambda v: torch.tensor(v, dtype=torch.float64))


@given(vectors, vectors)
def test_a_rotation_turns_vectors_as_its_matrix_does(omega: torch.Tensor, v: torch.Tensor) -> None:
    q = quat_from_vector(omega)
    assert np.allclose(rotate(q, v).numpy(), rotation_from_quat(q.numpy()) @ v.numpy(), atol=1e-12)
    assert torch.allclose(rotate(conjugate(q), rotate(q, v)), v, atol=1e-12)


@given(vectors, vectors)
def test_a_product_turns_by_its_right_factor_first(a: torch.Tensor, b: torch.Tensor) -> None:
    p, q = quat_from_vector(a), quat_from_vector(b)
    both = rotation_from_quat(quat_product(p, q).numpy())
    assert np.allclose(both, rotation_from_quat(p.numpy()) @ rotation_from_quat(q.numpy()), atol=1e-12)


@given(vectors)
def test_logarithm_undoes_the_exponential(omega: torch.Tensor) -> None:
    assert torch.allclose(vector_from_quat(quat_from_vector(omega)), omega, atol=1e-9)


@given(vectors, vectors)
def test_the_shortest_turn_leads_from_one_direction_to_the_other(a: torch.Tensor, b: torch.Tensor) -> None:
    a, b = a + torch.tensor([0, 0, 2.0]), b - torch.tensor([0, 2.0, 0])
    a, b = a / a.norm(), b / b.norm()
    assert torch.allclose(rotate(quat_between(a, b), a), b, atol=1e-9)
    assert torch.allclose(rotate(quat_between(a, -a), a), -a, atol=1e-9)


def test_a_zero_rotation_has_a_gradient() -> None:
    omega = torch.zeros(1, 3, requires_grad=True)
    rotate(quat_from_vector(omega), torch.tensor([1.0, 0, 0])).sum().backward()
    assert omega.grad is not None and torch.isfinite(omega.grad).all()
    assert torch.allclose(omega.grad, torch.tensor([[0.0, -1.0, 1.0]]))


@pytest.mark.parametrize("tilt", [0.0, 1e-12, 1e-9, 1e-6, 0.3])
@pytest.mark.parametrize("pole", [[0.0, 0.0, 1.0], [0.0, 0.0, -1.0], [1.0, 0.0, 0.0]])
def test_half_a_turn_is_as_exact_near_the_poles(pole: list[float], tilt: float) -> None:
    a = torch.nn.functional.normalize(
        torch.tensor(pole, dtype=torch.float64) + tilt * torch.tensor([0.3, 0.8, 0.5]), dim=-1
    )
    assert torch.allclose(rotate(quat_between(a, -a), a), -a, atol=1e-14)
