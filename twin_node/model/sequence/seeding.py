"""What a sequence's Gaussians start from: known points, what the first images agree on, or random points."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import torch
from scipy.spatial import cKDTree

from twin_node.model.parameters import SeedParameters
from twin_node.model.ply import SH_C0, StoredGaussians
from twin_node.model.seeding import seed
from twin_node.model.sequence.field import Box
from twin_node.model.sequence.recording import ColouredPoints, Recording
from twin_node.model.sweep import shell_around
from twin_node.scene import Float64, View
from twin_node.thinning import thinned

POINT_OPACITY = 0.1
"""Opacity of a Gaussian that stands for a point, as published."""
SWEPT_VIEWS = 6
"""Images that depth is swept from, at most: the sweep compares all pairs."""
RANDOM_REACH = 0.33
"""Half side of the cube of random points, in units of the cameras' distance: 1.3 of 4 as published for D-NeRF."""
BOX_SHARE, BOX_MARGIN = 0.01, 0.1
"""Share of the Gaussians that each face of the box may leave out, and what is added, as a share of its sides."""


def start_gaussians(recording: Recording, count: int, degree: int, random_seed: int) -> StoredGaussians:
    """At most `count` Gaussians, and at least one, with harmonics of `degree`, all but the constant zero."""
    first = recording.sets()[0].views
    if recording.points is not None:
        return _from_points(recording.points, count, degree, random_seed)
    if len(first) > 1 or first[0].depth is not None:
        found = _from_images(tuple(thinned(first, SWEPT_VIEWS)), count, degree)
        if len(found.means):
            return found
    return _from_points(_random_points(recording, count, random_seed), count, degree, random_seed)


def box_around(recording: Recording, gaussians: StoredGaussians) -> Box:
    """The box of almost all Gaussians, within the cameras' reach about what they look at: outliers cost resolution."""
    shell = shell_around([view.camera for view in recording.train], 1.0)
    means = gaussians.means.astype(np.float64)
    near = means[np.linalg.norm(means - shell.centre, axis=1) <= shell.radius]
    chosen = near if len(near) > len(means) / 10 else means
    lower, upper = np.quantile(chosen, BOX_SHARE, axis=0), np.quantile(chosen, 1 - BOX_SHARE, axis=0)
    sides = np.maximum(upper - lower, 1e-3 * shell.radius)
    margin = BOX_MARGIN * sides

    def tensor(corner: Float64) -> torch.Tensor:
        return torch.tensor(corner, dtype=torch.float32)

    return Box(tensor(lower - margin), tensor(lower + sides + margin))


def _from_images(views: tuple[View, ...], count: int, degree: int) -> StoredGaussians:
    born = seed(views, [None] * len(views), SeedParameters(), count, torch.device("cpu")).born
    opacity = born.opacities.numpy()
    return StoredGaussians(
        born.means.numpy(),
        born.quats.numpy(),
        born.scales.log().numpy(),
        np.log(opacity / (1 - opacity)),
        _harmonics(born.rgb.numpy(), degree),
    )


def _from_points(points: ColouredPoints, count: int, degree: int, random_seed: int) -> StoredGaussians:
    """Round Gaussians as wide as the mean distance to the three nearest points, as published."""
    if len(points.positions) > count:
        chosen = np.sort(np.random.default_rng(random_seed).choice(len(points.positions), count, replace=False))
        points = replace(points, positions=points.positions[chosen], rgb=points.rgb[chosen])
    n = len(points.positions)
    distances = cKDTree(points.positions).query(points.positions, k=min(4, n))[0].reshape(n, -1)[:, 1:]
    spacing = np.maximum(distances.mean(1) if distances.shape[1] else np.ones(n), 1e-7)
    quats = np.zeros((n, 4), np.float32)
    quats[:, 0] = 1
    return StoredGaussians(
        points.positions.astype(np.float32),
        quats,
        np.repeat(np.log(spacing)[:, None], 3, 1).astype(np.float32),
        np.full(n, np.log(POINT_OPACITY / (1 - POINT_OPACITY)), np.float32),
        _harmonics(points.rgb, degree),
    )


def _random_points(recording: Recording, count: int, random_seed: int) -> ColouredPoints:
    shell = shell_around([view.camera for view in recording.train], 1.0)
    random = np.random.default_rng(random_seed)
    positions = shell.centre + RANDOM_REACH * shell.radius * random.uniform(-1, 1, (count, 3))
    return ColouredPoints(positions, random.random((count, 3)).astype(np.float32))


def _harmonics(rgb: np.ndarray, degree: int) -> np.ndarray:
    sh = np.zeros((len(rgb), (degree + 1) ** 2, 3), np.float32)
    sh[:, 0] = (rgb - 0.5) / SH_C0
    return sh
