"""The forecaster: from the twin's state to occupied, free and unknown space now and up to 200 ms ahead."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.bound import Bound, BoundParameters
from twin_node.forecast.carving import Carved, Carver, CarvingParameters
from twin_node.forecast.grid import encode_runs, spread
from twin_node.forecast.obstacles import Motion
from twin_node.forecast.parts import Parts, PartVelocities, split
from twin_node.forecast.static import StaticParameters, StaticSpace
from twin_node.forecast.tables import RigTables
from twin_node.forecast.tracks import Tracks
from twin_node.scene import HORIZONS_NS, Float64, Grid, Occupancy, OccupancyLayer, TwinState, UInt32

CORE_PROBABILITY = 230
"""Of voxels where the parts themselves are forecast: the share of such voxels that came true on recordings."""
BOUND_PROBABILITY = 90
"""Of voxels that only the error bound adds."""


@dataclass(frozen=True)
class ForecastParameters:
    """Parameters of the forecaster's steps."""

    carving: CarvingParameters = field(default_factory=CarvingParameters)
    bound: BoundParameters = field(default_factory=BoundParameters)
    static: StaticParameters = field(default_factory=StaticParameters)


@dataclass(frozen=True)
class ForecastQuality:
    """How well the forecasts have been keeping what they promise."""

    coverage: float
    """Share of the space seen to move that lay inside the forecast made for that time, over the last 120 image sets;
    NaN before the first has come due."""
    target: float
    """Coverage aimed at."""
    bound_radius: float
    """Median radius of the bound at the last horizon, m; 0 where nothing moves."""
    factor: float
    """What the parts' own errors are multiplied by."""
    expert_weights: Float64
    """[E] mean weights of persistence, constant velocity, damped, constant acceleration, autoregression."""


class Forecaster:
    """Forecasts the occupancy of one grid, state by state."""

    def __init__(self, grid: Grid, parameters: ForecastParameters | None = None) -> None:
        self.grid = grid
        self.parameters = parameters or ForecastParameters()
        self._tables = RigTables(grid)
        self._carver = Carver(self._tables, self.parameters.carving)
        self._velocities = PartVelocities(self._tables)
        self._static = StaticSpace(grid, self.parameters.static)
        self._bound = Bound(self.parameters.bound)
        self._tracks: Tracks | None = None
        self._issued: deque[_Issued] = deque(maxlen=64)
        self._radii = np.zeros((len(HORIZONS_NS), 0))

    @property
    def quality(self) -> ForecastQuality:
        """The record as of the last update."""
        tracks = self._tracks
        return ForecastQuality(
            coverage=self._bound.coverage,
            target=self.parameters.bound.coverage,
            bound_radius=float(np.median(self._radii[-1])) if self._radii.shape[1] else 0.0,
            factor=self._bound.factor,
            expert_weights=tracks.mean_weights if tracks else np.zeros(0),
        )

    @property
    def motion(self) -> Motion:
        """Where the parts are, how they move, and their bounds, as of the last update."""
        if self._tracks is None or len(self._tracks.positions) == 0:
            return Motion(np.zeros((0, 3)), np.zeros((0, 3)), self._radii)
        return Motion(self._tracks.positions[-1], self._tracks.velocities, self._radii)

    def update(self, state: TwinState, publish_stamp: int) -> Occupancy:
        """Occupancy at `publish_stamp` + `HORIZONS_NS`, on the evidence up to `state.stamp` (both ns, one clock)."""
        horizons = (publish_stamp - state.stamp + np.array(HORIZONS_NS)) * 1e-9
        carved = self._carver.carve(state, self._speed())
        parts = split(self.grid, carved.moving)
        self._follow(state, parts, float(horizons[-1]))
        self._judge(state.stamp, carved.moving)
        layers = self._layers(parts, horizons)
        self._issued.append(_Issued(publish_stamp + HORIZONS_NS[-1], layers[-1].indices.astype(np.int64)))
        static = self._static.update(state, self._carver)
        return Occupancy(
            stamp=state.stamp,
            publish_stamp=publish_stamp,
            grid=self.grid,
            layers=layers,
            static=static,
            unknown_runs=self._unknown(carved, static),
        )

    def _speed(self) -> float:
        """How fast things move just now, m/s: the 95th percentile over the parts."""
        if self._tracks is None or len(self._tracks.velocities) == 0:
            return 0.0
        return float(np.percentile(np.linalg.norm(self._tracks.velocities, axis=1), 95))

    def _follow(self, state: TwinState, parts: Parts, horizon: float) -> None:
        """Continues the tracks into the parts seen now."""
        if self._tracks is None:
            self._tracks = Tracks(horizon)
        expected = self._tracks.expected_velocities(parts.centers)
        velocities = self._velocities.update(state, parts, expected)
        self._tracks.advance(state.stamp * 1e-9, parts.centers, velocities)

    def _judge(self, stamp: int, moving: NDArray[np.int64]) -> None:
        """Scores the forecast made for now against what is seen to move now."""
        due = None
        while self._issued and self._issued[0].valid_at <= stamp:
            due = self._issued.popleft()
        if due is not None and len(moving):
            self._bound.observe(float(np.isin(moving, due.indices, assume_unique=True).mean()))

    def _layers(self, parts: Parts, horizons: Float64) -> tuple[OccupancyLayer, ...]:
        """Every part moved on by the experts and widened by the bound, per horizon."""
        tracks = self._tracks
        assert tracks is not None
        moved = tracks.displacements(horizons)
        speeds = np.linalg.norm(tracks.velocities, axis=1)
        ages = tracks.ages_s
        self._radii = self._bound.radii(tracks.own_errors, speeds, ages, horizons, tracks.horizon_s)
        layers = []
        for horizon, displacement, radius in zip(HORIZONS_NS, moved, self._radii, strict=True):
            points = parts.points + displacement[parts.labels]
            grown = spread(self.grid, points, radius[parts.labels])
            probability = np.where(grown.core, CORE_PROBABILITY, BOUND_PROBABILITY).astype(np.uint8)
            layers.append(OccupancyLayer(horizon, grown.indices.astype(np.uint32), probability))
        return tuple(layers)

    def _unknown(self, carved: Carved, static: OccupancyLayer) -> UInt32:
        """Runs of unknown voxels, less those known to stand."""
        unknown = np.zeros(self.grid.size, np.bool_)
        unknown[carved.unknown] = True
        unknown[static.indices] = False
        return encode_runs(unknown)


@dataclass(frozen=True)
class _Issued:
    """A forecast waiting for the truth."""

    valid_at: int
    indices: NDArray[np.int64]
