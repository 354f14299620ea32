"""Forecasts of named points, such as the joints of a motion capture or the markers of a tracker."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_node.forecast.bound import BoundParameters
from twin_node.forecast.experts import EXPERT_NAMES
from twin_node.forecast.prediction import Predictor
from twin_node.forecast.records import Rows
from twin_node.forecast.tracks import Tracks
from twin_node.scene import Float64


@dataclass(frozen=True)
class PointForecast:
    """Where J points will be after H horizons; NaN for points that were not seen now."""

    displacements: Float64
    """[H, J, 3] from where they were seen now, m."""
    radii: Float64
    """[H, J] about the displaced points that are to hold them, m."""
    single: Float64
    """[E, J, 3] displacements by each expert alone (`experts.EXPERT_NAMES`) at the last horizon, m."""


class PointForecaster:
    """Forecasts a fixed number of points sample by sample, with the experts and the bound of `Forecaster`."""

    def __init__(self, count: int, horizons_s: Float64, parameters: BoundParameters | None = None) -> None:
        """`horizons_s` [H]: how far ahead of each sample to forecast, s, rising."""
        self.horizons_s = np.asarray(horizons_s, dtype=np.float64)
        self._count = count
        self._tracks = Tracks()
        self._predictor = Predictor(parameters)
        self._rows: Rows = np.full(count, -1, np.int64)

    def update(self, time: float, positions: Float64) -> PointForecast:
        """Forecasts from where the points are at `time` (s, rising): positions [J, 3] in metres, NaN where not seen."""
        seen = np.flatnonzero(np.isfinite(positions).all(axis=1))
        association = self._tracks.extend(time, positions[seen], self._rows[seen])
        self._rows = np.full(self._count, -1, np.int64)
        self._rows[seen] = np.arange(len(seen))
        self._predictor.advance(self._tracks.history, association, float(self.horizons_s[-1]))
        prediction = self._predictor.predict(self.horizons_s)
        displacements = np.full((len(self.horizons_s), self._count, 3), np.nan)
        displacements[:, seen] = prediction.displacements
        radii = np.full((len(self.horizons_s), self._count), np.nan)
        radii[:, seen] = prediction.radii
        single = np.full((len(EXPERT_NAMES), self._count, 3), np.nan)
        single[:, seen] = self._predictor.alone
        return PointForecast(displacements, radii, single)
