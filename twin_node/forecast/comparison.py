"""Scores several forecasts of the same evidence side by side, as the truth about them arrives."""

from __future__ import annotations

from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass, field

import numpy as np

from twin_node.forecast.score import (
    blocked_volume,
    iou,
    litres_per_voxel,
    nearest_error,
    projected,
    score_points,
)
from twin_node.scene import Bool, Float64, Occupancy, TwinState, UInt32, View


class Truth:
    """What a recording knows about its scene besides what the twin was given: of all that follows, nothing."""

    source: str
    """Where it comes from, in words."""

    def points(self, stamp: int, evidence: int) -> Float64 | None:
        """Points [n, 3] in metres that are occupied at a stamp (ns), of those that a forecast can be asked for whose
        evidence is as of another; None where nothing is known."""
        return None

    def occupied(self, stamp: int) -> Float64 | None:
        """Points [n, 3] in metres of all that moving things occupy at a stamp; None where that is not known exactly."""
        return None

    def volume_l(self, stamp: int) -> float | None:
        """Volume in litres of all that is occupied by moving things at a stamp; None where unknown."""
        return None

    def pixels(self, view: View) -> Bool | None:
        """[H, W] pixels of the moving things in a view; None where unknown."""
        return None

    def observe(self, state: TwinState, seen: Occupancy) -> None:
        """Takes in a state, and in the first layer of `seen` what it showed to move: for who knows nothing better."""


@dataclass(frozen=True)
class Score:
    """How good one kind of forecast was; None where the truth cannot tell."""

    recall: float | None
    """Share of the true points that lay inside the forecast made 200 ms before."""
    recall_held: float | None
    """Share that lay inside it or in what was published as standing, as all is that rests for long."""
    recall_now: float | None
    """Share that lay inside the layer for the time of publication."""
    recall_new: float | None
    """As `recall`, of points whose voxel was not occupied when the forecast's evidence was taken: truly, or, where the
    truth does not know, as the reference forecast had seen."""
    volume_l: float | None
    """Mean volume that the forecast blocks at 200 ms: moving and unknown voxels, litres."""
    moving_volume_l: float | None
    """Mean volume of the moving voxels alone, litres."""
    inflation: float | None
    """Mean volume of the moving voxels over the true one, of the forecasts for times at which that is known."""
    iou: float | None
    """Mean overlap (intersection over union) with the true pixels at its time of the projected voxels that are
    occupied more likely than not: the forecast without its bound."""
    error_mm: float | None
    """Mean distance from the true points to the forecast, 0 inside it, mm; without those of forecasts of no voxel."""


class Comparison:
    """Forecasts by name, scored at their last horizon when their time has come."""

    def __init__(self, truth: Truth, reference: str) -> None:
        """`reference` names the forecast whose first layer tells what was seen to be occupied (persistence), where
        the truth does not know what was."""
        self._truth = truth
        self._reference = reference
        self._pending: deque[_Pending] = deque()
        self._tallies: dict[str, _Tally] = {}

    def add(self, state: TwinState, forecasts: Mapping[str, Occupancy]) -> None:
        """Takes in the forecasts of a state, all for the same times (none: settles only); states come in order."""
        while self._pending and self._pending[0].valid_at <= state.stamp:
            self._settle(self._pending.popleft(), state)
        if not forecasts:
            return
        one = next(iter(forecasts.values()))
        self._pending.append(_Pending(one.publish_stamp + one.layers[-1].horizon_ns, dict(forecasts)))

    def scores(self) -> dict[str, Score]:
        """Scores of all forecasts whose time has come, by name."""
        return {name: tally.score() for name, tally in self._tallies.items()}

    def _settle(self, pending: _Pending, state: TwinState) -> None:
        """Scores forecasts for about the time of `state`, the first one not before it."""
        before = self._occupied_before(pending)
        for name, forecast in pending.forecasts.items():
            tally = self._tallies.setdefault(name, _Tally())
            tally.add_volume(forecast, self._truth.volume_l(pending.valid_at))
            now = self._truth.points(forecast.publish_stamp, forecast.stamp)
            tally.add_points(forecast, before, now, self._truth.points(pending.valid_at, forecast.stamp))
            for view in state.frames.views:
                pixels = self._truth.pixels(view)
                if pixels is not None and abs(view.stamp - pending.valid_at) <= NEAR_NS:
                    tally.add_pixels(forecast, view, pixels)

    def _occupied_before(self, pending: _Pending) -> UInt32:
        """Flat indices of what was occupied when the forecasts' evidence was taken."""
        reference = pending.forecasts[self._reference]
        points = self._truth.occupied(reference.stamp)
        if points is None:
            return reference.layers[0].indices
        indices = reference.grid.indices(points)
        return indices[indices >= 0].astype(np.uint32)


NEAR_NS = 20_000_000
"""An image this far from a forecast's time still shows its truth: half a period at 25 Hz."""

LIKELY = 128
"""Probability (of 255) from which a voxel is occupied more likely than not."""


@dataclass(frozen=True)
class _Pending:
    valid_at: int
    forecasts: dict[str, Occupancy]


@dataclass
class _Tally:
    """Sums over the forecasts of one kind."""

    now_found: int = 0
    now_of: int = 0
    found: int = 0
    of: int = 0
    held: int = 0
    new_found: int = 0
    new_of: int = 0
    blocked: list[float] = field(default_factory=list)
    moving: list[float] = field(default_factory=list)
    compared: list[float] = field(default_factory=list)
    """Those of `moving` at times whose true volume is known."""
    true_volumes: list[float] = field(default_factory=list)
    overlaps: list[float] = field(default_factory=list)
    errors_m: float = 0.0
    errors_of: int = 0

    def add_volume(self, forecast: Occupancy, true_volume: float | None) -> None:
        layer = forecast.layers[-1]
        self.blocked.append(blocked_volume(forecast, layer))
        self.moving.append(len(layer.indices) * litres_per_voxel(forecast.grid))
        if true_volume is not None:
            self.compared.append(self.moving[-1])
            self.true_volumes.append(true_volume)

    def add_points(self, forecast: Occupancy, before: UInt32, now: Float64 | None, later: Float64 | None) -> None:
        grid, first, last = forecast.grid, forecast.layers[0], forecast.layers[-1]
        if now is not None:
            score = score_points(grid, first.indices, now, before)
            self.now_found, self.now_of = self.now_found + score.found, self.now_of + score.of
        if later is not None:
            score = score_points(grid, last.indices, later, before)
            self.found, self.of = self.found + score.found, self.of + score.of
            self.new_found, self.new_of = self.new_found + score.new_found, self.new_of + score.new_of
            blocked = np.concatenate([last.indices, forecast.static.indices])
            self.held += score_points(grid, blocked, later, before).found
            errors = nearest_error(grid, last, later)
            errors = errors[np.isfinite(errors)]
            self.errors_m, self.errors_of = self.errors_m + float(errors.sum()), self.errors_of + len(errors)

    def add_pixels(self, forecast: Occupancy, view: View, truth: Bool) -> None:
        layer = forecast.layers[-1]
        likely = layer.indices[layer.probability >= LIKELY]
        overlap = iou(projected(view.camera, forecast.grid, likely), truth)
        if np.isfinite(overlap):
            self.overlaps.append(overlap)

    def score(self) -> Score:
        return Score(
            recall=_share(self.found, self.of),
            recall_held=_share(self.held, self.of),
            recall_now=_share(self.now_found, self.now_of),
            recall_new=_share(self.new_found, self.new_of),
            volume_l=_mean(self.blocked),
            moving_volume_l=_mean(self.moving),
            inflation=_share(sum(self.compared), sum(self.true_volumes)),
            iou=_mean(self.overlaps),
            error_mm=_share(1e3 * self.errors_m, self.errors_of),
        )


def _share(part: float, whole: float) -> float | None:
    return part / whole if whole else None


def _mean(values: list[float]) -> float | None:
    return float(np.mean(values)) if values else None
