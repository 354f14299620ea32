"""What shapes a board may have, and how one that was refined differs from the one stated."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np

from twin_node.scene import Float64

LEAST_BOW = 1e-6
"""Of a bow that corners tell: less is rounding."""


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

    def as_json(self) -> dict[str, float]:
        """What `--json` prints."""
        return asdict(self) | {"size_sigma": self.size_sigma}


def board_shape(stated: Float64, found: Float64) -> BoardShape:
    """The shape of a flat board, of corners [P, 3] m as stated and as found."""
    flat, drawn = (points[:, :2] - points[:, :2].mean(axis=0) for points in (stated, found))
    by_place = np.linalg.lstsq(flat, drawn, rcond=None)[0]
    long, short = np.linalg.svd(by_place, compute_uv=False)
    off, unlike = found - stated, drawn - flat @ by_place
    return BoardShape(_rms(off), float(long / short - 1), _rms(unlike))


def sheet_shapes(points: Float64) -> Float64:
    """[3 P, n] m by which a sheet's corners [P, 3] move as it is stretched, sheared and bowed, in shares of its size.

    Stretch is along x and against y. Bows are the quadratic heights: rolled up along some direction, domed, twisted;
    three, fewer where two rows of corners do not tell them.
    """
    flat = points[:, :2] - points[:, :2].mean(axis=0)
    reach = np.linalg.norm(flat, axis=1).max()
    x, y = flat.T
    none = np.zeros_like(x)
    in_plane = [np.stack([x, -y, none], axis=1) / 2, np.stack([y, x, none], axis=1) / 2]
    tilts, bows = np.stack([none + reach, x, y], axis=1), np.stack([x * x, x * y, y * y], axis=1)
    bows = bows - tilts @ np.linalg.lstsq(tilts, bows, rcond=None)[0]
    modes, sizes, _ = np.linalg.svd(bows / reach**2, full_matrices=False)
    heights = modes[:, sizes > LEAST_BOW].T
    across = [np.stack([none, none, 2 * reach * height / np.abs(height).max()], axis=1) for height in heights]
    return np.stack([shape.ravel() for shape in (*in_plane, *across)], axis=1)


def corner_step(points: Float64) -> float:
    """Median distance, m, from a corner of a board [P, 3] to the nearest other."""
    distances = np.linalg.norm(points[:, None] - points[None], axis=2)
    np.fill_diagonal(distances, np.inf)
    return float(np.median(distances.min(axis=1)))


def _rms(vectors: Float64) -> float:
    return float(np.sqrt((vectors**2).sum(axis=1).mean()))
