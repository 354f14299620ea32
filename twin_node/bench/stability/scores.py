"""What one run is worth: recall tick by tick, silent failures, and how well the pictures show what was there."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.grid import decode_runs
from twin_node.forecast.score import blocked_volume
from twin_node.scene import Bool, Grid, Occupancy

LEAST_RECALL = 0.95
"""A forecast with less has failed."""
OUTSIDE_VOXELS = 2
"""Truth farther than so many voxels from all that is not free has failed too, however little it is."""
EPISODE_TICKS = 3
"""Ticks in a row that make a silent failure: 100 ms at 30 Hz."""
LEAST_VOXELS = 8
"""Ticks with fewer true voxels tell nothing."""


@dataclass(frozen=True)
class Held:
    """What one forecast held of the truth."""

    found: int
    """True voxels that were not reported free."""
    of: int
    found_moving: int
    """Those of them that were reported to be moving space."""
    is_outside: bool
    """Whether some true voxel lies more than `OUTSIDE_VOXELS` from all that was not free."""
    blocked_l: float
    """Moving and unknown space, litres."""

    @property
    def fails(self) -> bool:
        """Whether a robot that trusted it might have been where something was."""
        return self.of >= LEAST_VOXELS and (self.found < LEAST_RECALL * self.of or self.is_outside)


def held(forecast: Occupancy, truth: NDArray[np.int64]) -> Held:
    """Scores the last layer of a forecast against flat indices [n] of the voxels that are occupied at its time.

    A voxel in no list is free; one that is moving, static or unknown may not be entered, and is held.
    """
    layer, grid = forecast.layers[-1], forecast.grid
    moving = np.zeros(grid.size, np.bool_)
    moving[layer.indices] = True
    taken = decode_runs(forecast.unknown_runs, grid.size) | moving
    taken[forecast.static.indices] = True
    missed = truth[~taken[truth]]
    return Held(
        len(truth) - len(missed),
        len(truth),
        int(np.count_nonzero(moving[truth])),
        bool(len(missed)) and _any_far(grid, taken, missed),
        blocked_volume(forecast, layer),
    )


_STEPS = np.stack(np.meshgrid(*[np.arange(-OUTSIDE_VOXELS, OUTSIDE_VOXELS + 1)] * 3, indexing="ij"), -1).reshape(-1, 3)
_NEAR = _STEPS[(_STEPS**2).sum(1) <= OUTSIDE_VOXELS**2]
"""Steps to all voxels within `OUTSIDE_VOXELS`."""


def _any_far(grid: Grid, taken: Bool, missed: NDArray[np.int64]) -> bool:
    """Whether some voxel of `missed` has none of `taken` [grid.size] near it."""
    places = np.stack(np.unravel_index(missed, grid.dims), -1)[:, None] + _NEAR
    inside = ((places >= 0) & (places < grid.dims)).all(-1)
    clipped = np.clip(places, 0, np.array(grid.dims) - 1)
    flat = (clipped[..., 0] * grid.dims[1] + clipped[..., 1]) * grid.dims[2] + clipped[..., 2]
    return bool((~(taken[flat] & inside).any(1)).any())


@dataclass(frozen=True)
class TickScore:
    """One tick of one method."""

    stamp: int
    """Evidence, ns."""
    valid_at: int
    """Time of the forecast's last layer, ns."""
    held: Held | None
    """None where it is not scored: at the start of a run, or where nothing was to be foreseen."""
    warned: bool
    """Whether the status said that something was wrong."""


def silent_failures(ticks: Sequence[TickScore]) -> int:
    """Episodes of `EPISODE_TICKS` or more ticks that fail and nobody says so.

    A failing tick is silent where no status from its evidence until its own time, when its truth is out, warns.
    """
    stamps = np.array([tick.stamp for tick in ticks])
    warned = np.append(0, np.cumsum([tick.warned for tick in ticks]))
    episodes = length = 0
    for index, tick in enumerate(ticks):
        if tick.held is None:
            continue
        last = int(np.searchsorted(stamps, tick.valid_at, side="right"))
        silent = tick.held.fails and warned[last] == warned[index]
        length = length + 1 if silent else 0
        episodes += length == EPISODE_TICKS
    return episodes


@dataclass(frozen=True)
class Outcome:
    """What one method made of one run."""

    ticks: tuple[TickScore, ...] = ()
    """Of forecasting methods."""
    psnr_moving_db: float | None = None
    """Of methods that make pictures."""

    @property
    def scored(self) -> list[Held]:
        """The scored ticks."""
        return [tick.held for tick in self.ticks if tick.held is not None and tick.held.of >= LEAST_VOXELS]


@dataclass(frozen=True)
class Pooled:
    """A method at one level of a failure, over all seeds."""

    recall: float | None
    recall_moving: float | None
    """As `recall`, in the moving layer alone: unknown and standing space left out."""
    outside_share: float | None
    """Share of the ticks with truth more than two voxels outside the bound."""
    blocked_l: float | None
    warning_share: float | None
    """Share of the ticks at which the status said that something was wrong."""
    silent_failures: int
    psnr_moving_db: float | None

    @staticmethod
    def of(outcomes: Sequence[Outcome]) -> Pooled:
        """Over the runs of one level."""
        scored = [one for outcome in outcomes for one in outcome.scored]
        whole = sum(one.of for one in scored)
        ticks = [tick for outcome in outcomes for tick in outcome.ticks]
        pictures = [outcome.psnr_moving_db for outcome in outcomes if outcome.psnr_moving_db is not None]
        return Pooled(
            recall=sum(one.found for one in scored) / whole if whole else None,
            recall_moving=sum(one.found_moving for one in scored) / whole if whole else None,
            outside_share=float(np.mean([one.is_outside for one in scored])) if scored else None,
            blocked_l=float(np.mean([one.blocked_l for one in scored])) if scored else None,
            warning_share=float(np.mean([tick.warned for tick in ticks])) if ticks else None,
            silent_failures=sum(silent_failures(outcome.ticks) for outcome in outcomes),
            psnr_moving_db=float(np.mean(pictures)) if pictures else None,
        )
