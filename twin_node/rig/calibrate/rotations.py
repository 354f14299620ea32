"""Poses as vectors, which solvers move."""

from __future__ import annotations

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from twin_node.geometry import pose
from twin_node.scene import Float64


def as_vector(T: Float64) -> Float64:
    """Rotation vector and translation [6] of a pose [4, 4]."""
    return np.concatenate([Rotation.from_matrix(T[:3, :3]).as_rotvec(), T[:3, 3]])


def as_pose(vector: Float64) -> Float64:
    """Pose [4, 4] of a rotation vector and translation [6]."""
    return pose(np.asarray(cv2.Rodrigues(vector[:3])[0], np.float64), vector[3:])


def cross_matrix(v: Float64) -> Float64:
    """[3, 3] matrix of the cross product with v [3]."""
    x, y, z = v
    return np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]])


def right_jacobian(rotation: Float64) -> Float64:
    """[3, 3] turn, right of a rotation vector's rotation, by a change of the vector (Sola et al. 2018, eq. 143)."""
    angle, cross = float(np.linalg.norm(rotation)), cross_matrix(rotation)
    if angle < 1e-6:
        return np.asarray(np.eye(3) - cross / 2)
    linear, square = (1 - np.cos(angle)) / angle**2, (angle - np.sin(angle)) / angle**3
    return np.asarray(np.eye(3) - linear * cross + square * cross @ cross)
