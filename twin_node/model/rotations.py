"""Quaternions and small rotations as torch operations; quaternions are w, x, y, z."""

from __future__ import annotations

import torch
from torch import Tensor

_PARTNERS = torch.tensor([[0, 1, 2, 3], [1, 0, 3, 2], [2, 3, 0, 1], [3, 2, 1, 0]])
_SIGNS = torch.tensor([[1.0, 1, 1, 1], [-1, 1, -1, 1], [-1, 1, 1, -1], [-1, -1, 1, 1]])
"""What the parts w, x, y, z of one quaternion are multiplied by for each part of their product with another."""


def quat_product(a: Tensor, b: Tensor) -> Tensor:
    """Hamilton product [..., 4] of a and b [..., 4]: the rotation b followed by a."""
    w, x, y, z = (a[..., None] * (b[..., _PARTNERS] * _SIGNS.to(b))).unbind(-2)
    product: Tensor = w + x + y + z
    return product


def cross(a: Tensor, b: Tensor) -> Tensor:
    """Cross product [..., 3] with all of broadcasting: `torch.linalg.cross` wants equally many dimensions."""
    if a.ndim == b.ndim:
        crossed: Tensor = torch.linalg.cross(a, b)
        return crossed
    ax, ay, az = a.unbind(-1)
    bx, by, bz = b.unbind(-1)
    return torch.stack([ay * bz - az * by, az * bx - ax * bz, ax * by - ay * bx], -1)


def conjugate(q: Tensor) -> Tensor:
    """Inverse [..., 4] of unit quaternions."""
    return torch.cat([q[..., :1], -q[..., 1:]], -1)


def rotate(q: Tensor, v: Tensor) -> Tensor:
    """Vectors v [..., 3] turned by unit quaternions q [..., 4]."""
    w, u = q[..., :1], q[..., 1:]
    t = 2 * cross(u, v)
    return v + w * t + cross(u, t)


def left_product(q: Tensor) -> Tensor:
    """Matrices [..., 4, 4] L of quaternions q [..., 4] with `L p = q p`."""
    w, x, y, z = q.unbind(-1)
    columns = [(w, x, y, z), (-x, w, z, -y), (-y, -z, w, x), (-z, y, -x, w)]
    return torch.stack([torch.stack(column, -1) for column in columns], -1)


def rotation_matrix(q: Tensor) -> Tensor:
    """Rotation matrices [..., 3, 3] of unit quaternions q [..., 4]."""
    w, u = q[..., 0, None, None], q[..., 1:]
    x, y, z = u.unbind(-1)
    o = torch.zeros_like(x)
    cross_matrix = torch.stack([torch.stack(row, -1) for row in ((o, -z, y), (z, o, -x), (-y, x, o))], -2)
    matrix: Tensor = torch.eye(3, dtype=q.dtype, device=q.device) + 2 * (w * cross_matrix + cross_matrix @ cross_matrix)
    return matrix


def quat_from_vector(omega: Tensor) -> Tensor:
    """Unit quaternions [..., 4] of rotation vectors [..., 3] in rad (exponential map, smooth at zero)."""
    half = omega / 2
    angle2 = half.square().sum(-1, keepdim=True)
    angle = (angle2 + 1e-24).sqrt()
    sinc = torch.where(angle2 < 1e-8, 1 - angle2 / 6, torch.sin(angle) / angle)
    return torch.cat([torch.cos(angle), half * sinc], -1)


def vector_from_quat(q: Tensor) -> Tensor:
    """Rotation vectors [..., 3] in rad, shorter than pi, of unit quaternions [..., 4] (logarithm)."""
    q = torch.where(q[..., :1] < 0, -q, q)
    norm = q[..., 1:].norm(dim=-1, keepdim=True)
    angle = 2 * torch.atan2(norm, q[..., :1])
    return q[..., 1:] * torch.where(norm < 1e-8, torch.full_like(norm, 2.0), angle / norm.clamp_min(1e-12))


def quat_between(a: Tensor, b: Tensor) -> Tensor:
    """Shortest rotation [..., 4] that takes unit vectors a to b [..., 3], about any axis where they are opposite."""
    q = torch.cat([1 + (a * b).sum(-1, keepdim=True), cross(a, b)], -1)
    x, y, z = a.unbind(-1)
    zero = torch.zeros_like(z)
    across = torch.where(z.abs()[..., None] < 0.9, torch.stack([-y, x, zero], -1), torch.stack([zero, -z, y], -1))
    opposite = q.norm(dim=-1, keepdim=True) < torch.finfo(q.dtype).eps ** 0.5
    q = torch.where(opposite, torch.cat([zero[..., None], across], -1), q)
    length: Tensor = q.norm(dim=-1, keepdim=True)
    return q / length
