"""What the forecast is compared with: simple forecasts of the same evidence."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_node.forecast.bound import PERSON_SPEED
from twin_node.forecast.evidence import Evidence, Observer
from twin_node.forecast.growth import reach_of, shifts_of, spread
from twin_node.forecast.narrowed import NarrowedStates
from twin_node.forecast.pace import Pace
from twin_node.forecast.sights import CarvingParameters
from twin_node.forecast.static import StaticParameters
from twin_node.robot import ArmModel
from twin_node.scene import HORIZONS_NS, Float64, Grid, Occupancy, OccupancyLayer, TwinState

RIM_PROBABILITY = 90
"""Of voxels that only the errors of the carving add."""
AHEAD_S = 0.2
"""Horizon that the worst case is grown for, s."""


@dataclass(frozen=True)
class Baselines:
    """The same evidence, forecast without a model of motion."""

    persistence: Occupancy
    """What moves stays where it was seen."""
    constant_velocity: Occupancy
    """What moves goes straight on at its velocity as seen."""
    worst_case: Occupancy
    """What moves may be anywhere within 1.6 m/s x 0.2 s of where it was seen, at every horizon."""


class BaselineForecaster:
    """Makes the baselines of a grid, state by state."""

    def __init__(
        self,
        grid: Grid,
        carving: CarvingParameters | None = None,
        static: StaticParameters | None = None,
        arm: ArmModel | None = None,
    ) -> None:
        """With the same arguments as the `Forecaster` they stand on the same evidence."""
        self.grid = grid
        self.places = np.zeros((3, 0), np.int32)
        """[3, n] voxel coordinates of what the last state showed to move, also in the rim about the grid."""
        self._narrowed = NarrowedStates(grid)
        self._pace = Pace()
        self._observer = Observer(grid, carving or CarvingParameters(), static or StaticParameters(), arm)

    def update(self, state: TwinState, publish_stamp: int) -> Baselines:
        """The baselines at `publish_stamp` + `HORIZONS_NS`, on the evidence up to `state.stamp` (ns)."""
        evidence = self._observer.observe(self._narrowed.of(state), self._pace.pauses_before(state.stamp))
        self.places = evidence.parts.places
        ahead = (publish_stamp - state.stamp + np.array(HORIZONS_NS)) * 1e-9
        still = np.zeros(len(ahead))
        return Baselines(
            persistence=self._occupancy(evidence, publish_stamp, still, 0.0),
            constant_velocity=self._occupancy(evidence, publish_stamp, ahead, 0.0),
            worst_case=self._occupancy(evidence, publish_stamp, still, PERSON_SPEED * AHEAD_S),
        )

    def _occupancy(self, evidence: Evidence, publish_stamp: int, travelled_s: Float64, radius: float) -> Occupancy:
        """What moves, `travelled_s` [H] further on at its velocity and grown by `radius` (m)."""
        parts = evidence.parts
        times, which = np.unique(travelled_s, return_inverse=True)
        reach = np.full((len(times), parts.count), reach_of(self.grid, np.array([radius]))[0])
        shifts = shifts_of(self.grid, evidence.motion.velocities * times[:, None, None])
        spreads = spread(self.grid, parts.points, shifts, reach)
        layers: list[OccupancyLayer] = []
        for horizon, row in zip(HORIZONS_NS, which, strict=True):
            probability = np.where(spreads[row].core, 255, 128 if radius else RIM_PROBABILITY).astype(np.uint8)
            layers.append(OccupancyLayer(horizon, spreads[row].indices, probability))
        return Occupancy(
            stamp=evidence.stamp,
            publish_stamp=publish_stamp,
            grid=self.grid,
            layers=tuple(layers),
            static=evidence.static,
            unknown_runs=evidence.unseen.result().unknown_runs,
        )
