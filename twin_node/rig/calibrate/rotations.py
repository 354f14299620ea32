"""Poses as solvers move them."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

from twin_node.geometry import cross, inverse_pose
from twin_node.scene import Float64


def cross_matrix(v: NDArray[np.floating]) -> Float64:
    """[..., 3, 3] matrices of the cross product with v [..., 3]."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2], out[..., 1, 2] = -v[..., 2], v[..., 1], -v[..., 0]
    out[..., 1, 0], out[..., 2, 0], out[..., 2, 1] = v[..., 2], -v[..., 1], v[..., 0]
    return out


def turning(rotvec: Float64) -> Float64:
    """[3, 3] the small turn that follows a rotation by a vector [3] (rad), by a small change of that vector.

    The left Jacobian of SO(3) (Sola, Deray and Atchuthan, "A micro Lie theory", 2018, equation 145).
    """
    angle, cross = float(np.linalg.norm(rotvec)), cross_matrix(rotvec)
    if angle < 1e-4:
        return np.asarray(np.eye(3) + cross / 2)
    return np.asarray(
        np.eye(3) + (1 - np.cos(angle)) / angle**2 * cross + (angle - np.sin(angle)) / angle**3 * cross @ cross
    )


def moved(T: Float64, change: Float64) -> Float64:
    """Poses [..., 4, 4] turned by a rotation vector about the outer frame's axes and shifted along them.

    `change` [..., 6]: rad, then m; the turn leaves the translation alone.
    """
    out = T.copy()
    out[..., :3, :3] = (
        Rotation.from_rotvec(change[..., :3].reshape(-1, 3)).as_matrix().reshape(*change.shape[:-1], 3, 3)
        @ T[..., :3, :3]
    )
    out[..., :3, 3] += change[..., 3:]
    return out


def apart(a: Float64, b: Float64) -> tuple[Float64, Float64]:
    """How far apart two cameras stand [...] (m), and by how much else they look [...] (rad).

    `a` and `b` [..., 4, 4] map to their optical frames.
    """
    shift = np.linalg.norm(inverse_pose(a)[..., :3, 3] - inverse_pose(b)[..., :3, 3], axis=-1)
    turned = a[..., :3, :3] @ b[..., :3, :3].swapaxes(-1, -2)
    turn = Rotation.from_matrix(turned.reshape(-1, 3, 3)).magnitude().reshape(turned.shape[:-2])
    return np.asarray(shift), np.asarray(turn)


def quat_product(a: Float64, b: Float64) -> Float64:
    """Hamilton products [..., 4] of quaternions [..., 4] (w, x, y, z)."""
    aw, av, bw, bv = a[..., :1], a[..., 1:], b[..., :1], b[..., 1:]
    real = aw * bw - (av * bv).sum(-1, keepdims=True)
    return np.concatenate([real, aw * bv + bw * av + cross(av, bv)], axis=-1)
