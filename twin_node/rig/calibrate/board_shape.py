"""How a board that was refined differs from the one stated, and what that leaves open of its size."""

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


def _rms(vectors: Float64) -> float:
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))
