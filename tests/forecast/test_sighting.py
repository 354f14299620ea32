"""How far what was seen may get: as far as the layers hold it, whatever box it is put into."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from twin_node.forecast import CoverParameters, cover
from twin_node.forecast.grid import encode_runs
from twin_node.forecast.parts import Parts, split
from twin_node.forecast.prediction import Prediction
from twin_node.forecast.sighting import Sighted, sighted
from twin_node.forecast.swerving import Swerves
from twin_node.scene import HORIZONS_NS, Bool, Float64, Grid, Obstacles, Occupancy, OccupancyLayer

GRID = Grid(np.array([-0.5, 0.25, 0.0]), 0.02, (31, 26, 40))
LATENCY_S = 0.08
HORIZONS = LATENCY_S + np.array(HORIZONS_NS) * 1e-9
STARTED = 0.9 * np.maximum(HORIZONS - 0.045, 0)


def moving(seed: int) -> tuple[Parts, np.ndarray]:
    """Voxels of a few blobs with rims, and some that rest."""
    rng = np.random.default_rng(seed)
    centers = GRID.centers(np.arange(GRID.size))
    apart = np.min([np.linalg.norm(centers - blob, axis=1) for blob in rng.choice(centers, 4)], axis=0)
    indices = np.flatnonzero(apart < 0.09)
    resting = np.unique(rng.choice(GRID.size, 30))
    return split(GRID, indices, np.asarray(apart[indices] < 0.06)), resting


def predicted(parts: Parts, seed: int) -> Prediction:
    rng = np.random.default_rng(seed + 1)
    shares = HORIZONS[:, None] ** rng.uniform(0.5, 2.0, parts.count)
    displacements = rng.normal(size=(parts.count, 3)) * shares[..., None]
    swerves = Swerves(displacements + rng.normal(size=(parts.count, 3)) * 0.1, rng.random(parts.count) < 0.2)
    return Prediction(displacements, 0.3 * shares, rng.random(parts.count) < 0.2, swerves)


def covered(seen: Sighted, most: int) -> Obstacles:
    """The cover of a forecast of what was seen."""
    layers = tuple(OccupancyLayer(ns, np.array([0], np.uint32), np.array([255], np.uint8)) for ns in HORIZONS_NS)
    static = OccupancyLayer(0, np.zeros(0, np.uint32), np.zeros(0, np.uint8))
    runs = encode_runs(np.zeros(GRID.size, np.bool_))
    told = Occupancy(0, round(LATENCY_S * 1e9), GRID, layers, static, runs)
    return cover(told, None, CoverParameters(most_seen=most, most_moving=most), sighted=seen)


def reach_about(obstacles: Obstacles, place: Float64, times: Float64) -> Float64:
    """How far what was seen at a place [3] gets by times [H] (s), by the box that lets it get farthest; 0: no box."""
    assert obstacles.reach_speeds is not None and obstacles.reach_delays is not None
    holds: Bool = (np.abs(obstacles.positions - place) < obstacles.sizes / 2).all(axis=1) & obstacles.as_seen
    lines = obstacles.reach_speeds[holds] * (times[:, None] - obstacles.reach_delays[holds])
    return np.asarray(lines.max(axis=1, initial=0.0))


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 2**31), most=st.integers(1, 80))
def test_a_box_lets_all_that_it_holds_get_as_far_as_the_forecast_does(seed: int, most: int) -> None:
    parts, resting = moving(seed)
    foreseen = predicted(parts, seed)
    obstacles = covered(sighted(GRID, parts, resting, foreseen, STARTED, HORIZONS), most)
    far = np.linalg.norm(foreseen.displacements, axis=2)
    swerved = np.linalg.norm(foreseen.swerves.displacements, axis=2)
    reach = np.where(foreseen.swerves.held, np.maximum(far, swerved), far) + foreseen.radii
    rim_reach = far + np.minimum(foreseen.radii, 0.05)
    for index, label, likely in zip(parts.indices[::7], parts.labels[::7], parts.likely[::7], strict=True):
        told = reach_about(obstacles, GRID.centers(np.array([index]))[0], HORIZONS)
        assert (told >= (reach if likely else rim_reach)[:, label] - 1e-9).all()
    for index in resting:
        assert (reach_about(obstacles, GRID.centers(np.array([index]))[0], HORIZONS) >= STARTED - 1e-9).all()


@pytest.mark.parametrize(("radius", "of_rims"), [(0.2, 0.05), (0.03, 0.03)])
def test_rims_are_widened_little_and_no_more_than_their_parts(radius: float, of_rims: float) -> None:
    parts, _ = moving(3)
    still = Prediction(
        np.zeros((5, parts.count, 3)),
        np.full((5, parts.count), radius),
        np.zeros(parts.count, np.bool_),
        Swerves(np.zeros((5, parts.count, 3)), np.zeros(parts.count, np.bool_)),
    )
    seen = sighted(GRID, parts, np.zeros(0, np.int64), still, STARTED, HORIZONS)
    rounding = np.sqrt(3) / 2 * GRID.voxel_size
    assert np.allclose(seen.likely.reached, radius + rounding)
    assert np.allclose(seen.rims.reached, of_rims + rounding)
    assert (seen.likely.speeds == 0).all() and (seen.rims.speeds == 0).all()


def test_what_rests_is_widened_as_the_layers_are() -> None:
    """By the rounding of places to voxels."""
    parts, resting = moving(3)
    seen = sighted(GRID, parts, resting, predicted(parts, 3), STARTED, HORIZONS)
    of_resting = seen.likely.reached[parts.count :]
    assert len(of_resting)
    assert np.allclose(of_resting, STARTED[0] + np.sqrt(3) / 2 * GRID.voxel_size)


def test_a_box_takes_nothing_from_groups_that_it_does_not_reach() -> None:
    """Only what is beside a hand that darts is held for as long as it."""
    indices = np.ravel_multi_index(np.array([[2, 3, 25], [5, 5, 5], [5, 5, 5]]), GRID.dims)
    parts = split(GRID, indices, np.ones(3, np.bool_))
    displacements = np.zeros((5, 2, 3))
    displacements[:, 1, 2] = 2.0 * HORIZONS
    quiet = Swerves(displacements, np.zeros(2, np.bool_))
    found = Prediction(displacements, np.full((5, 2), 0.03), np.zeros(2, np.bool_), quiet)
    obstacles = covered(sighted(GRID, parts, np.zeros(0, np.int64), found, STARTED, HORIZONS), 8)
    near, darting = (reach_about(obstacles, place, HORIZONS)[-1] for place in GRID.centers(indices[[0, 2]]))
    assert near < 0.06
    assert darting > 0.5


def test_of_a_box_without_a_known_group_nothing_is_said() -> None:
    """The law takes its own speed for it, and not that nobody gets anywhere."""
    parts, _ = moving(5)
    foreseen = predicted(parts, 5)
    seen = sighted(GRID, parts, np.zeros(0, np.int64), foreseen, STARTED, HORIZONS)
    strange = np.flatnonzero(~np.isin(np.arange(GRID.size), parts.indices))[-1:]
    lost = replace(seen.likely, voxels=(strange,))
    wild = replace(seen.likely, speeds=np.full_like(seen.likely.speeds, np.nan))
    for likely in (lost, wild):
        obstacles = covered(replace(seen, likely=likely, rims=likely), 20)
        assert obstacles.as_seen.any() and obstacles.reach_speeds is not None
        assert (obstacles.reach_speeds == 0).all()
