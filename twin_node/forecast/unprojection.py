"""Points on the surfaces that a camera measures."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.scene import Float32, View

FINER = 3
"""Points along each side of a pixel: where a surface is seen at a slant, pixels are wider than voxels."""


def unproject(view: View, where: NDArray[np.bool_], finer: int = FINER) -> Float32:
    """Base-frame points [n, 3] (m) of the pixels in `where` [H, W] of a view with depth: `finer`^2 all over each."""
    fine = cv2.resize(where.astype(np.uint8), None, fx=finer, fy=finer, interpolation=cv2.INTER_NEAREST)
    rows, columns = np.nonzero(fine)
    return points_at(view, rows, columns, finer)


def points_at(view: View, rows: NDArray[np.int64], columns: NDArray[np.int64], finer: int = 1) -> Float32:
    """Base-frame points [n, 3] (m) that a view with depth measures at `rows` and `columns` [n], `finer` to a pixel."""
    assert view.depth is not None
    z = view.depth[rows // finer, columns // finer]
    K, T = view.camera.K, view.camera.T_base_cam
    x = from_middle(columns, K[0, 2], finer) * z / np.float32(K[0, 0])
    y = from_middle(rows, K[1, 2], finer) * z / np.float32(K[1, 1])
    return np.stack([R[0] * x + R[1] * y + R[2] * z + R[3] for R in T[:3].astype(np.float32)], axis=1)


def from_middle(places: NDArray[np.int64], center: float, finer: int = FINER) -> Float32:
    """Pixels [n] from `center` along an axis to points numbered `finer` to a pixel."""
    return ((places + 0.5) / finer - center).astype(np.float32)
