"""What shapes a board may have, and how one that was refined differs from the one stated."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_node.scene import Float64


@dataclass(frozen=True)
class BoardShape:
    """A refined board beside the one stated."""

    off_m: float
    """Root mean square distance, m, of its corners from where they were stated."""
    stretch: float
    """By what share one direction is longer than the one across it, as printers stretch paper."""
    unlike_m: float
    """Root mean square distance, m, within its plane, that no stretching and no bending explains."""

    @property
    def size_sigma(self) -> float:
        """1 sigma of its size, as a share: half of the stretch.

        Pictures do not tell a board's size. A print that is stretched by so much one way may be so much off the other.
        """
        return self.stretch / 2


def board_shape(stated: Float64, found: Float64) -> BoardShape:
    """The shape of a flat board, of corners [P, 3] m as stated and as found."""
    flat, drawn = (points[:, :2] - points[:, :2].mean(axis=0) for points in (stated, found))
    by_place = np.linalg.lstsq(flat, drawn, rcond=None)[0]
    long, short = np.linalg.svd(by_place, compute_uv=False)
    off, unlike = found - stated, drawn - flat @ by_place
    return BoardShape(_rms(off), float(long / short - 1), _rms(unlike))


def stretch_of(points: Float64) -> Float64:
    """[3 P, 2] m of flat corners [P, 3] by their stretch along x and against y, and by their shear."""
    x, y = (points[:, :2] - points[:, :2].mean(axis=0)).T / 2
    none = np.zeros_like(x)
    return np.stack([np.stack([x, -y, none], axis=1).ravel(), np.stack([y, x, none], axis=1).ravel()], axis=1)


def corner_step(points: Float64) -> float:
    """Median distance, m, from a corner of a board [P, 3] to the nearest other."""
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    np.fill_diagonal(distances, np.inf)
    return float(np.median(distances.min(axis=1)))


def _rms(vectors: Float64) -> float:
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))
