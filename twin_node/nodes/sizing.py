"""Picks the live model's size by need: the largest that keeps a budget on the sets that come."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from itertools import takewhile
from pathlib import Path

import numpy as np

from twin_node.forecast import Forecaster, ForecastParameters
from twin_node.model import ModelParameters, WindowModel
from twin_node.nodes.latency import ASSUMED_LATENCY_NS
from twin_node.nodes.sizes import SIZES
from twin_node.robot import ArmModel
from twin_node.scene import FrameSet, Grid, TwinState
from twin_node.scene.narrowing import Narrower

TRIED_SETS = 10
"""Sets that a size is timed on; the first, which builds the model, does not count."""
SPARE = 0.8
"""Share of a budget that the median set may take: slow sets take longer."""
AT_REST = 1.9
"""How many times as long a set takes while people work as while nothing moves, of whatever size: 27 for 14, 31 for 16,
35 for 18 and 39 for 20 ms from `tiny` to `large`."""
AT_WORK = 0.05
"""Share of moving pixels from which people are taken to be at work; somebody who reaches in makes 6 %."""
FILE = "size"
"""Where a launch's size stands, in the folder of what is kept."""


@dataclass(frozen=True)
class Choice:
    """A size, and why."""

    size: str
    """In `SIZES`."""
    reason: str
    """One line to tell the user."""


def best_within(budget_ms: float, sizes: Sequence[str], timed_ms: Callable[[str], float]) -> Choice:
    """The largest of `sizes`, which rise, before the first that takes more than `budget_ms` of a set.

    They are tried from the smallest up, so that a slow machine does not spend its time on what it cannot do. Where none
    keeps the budget, the smallest is taken.
    """
    taken, spent = sizes[0], timed_ms(sizes[0])
    if spent > SPARE * budget_ms:
        return Choice(taken, f"size {taken}: {spent:.0f} ms per set here, the fastest; none keeps {budget_ms:g} ms")
    for name in sizes[1:]:
        more = timed_ms(name)
        if more > SPARE * budget_ms:
            break
        taken, spent = name, more
    return Choice(taken, f"size {taken}: {spent:.0f} ms per set here, the best within {budget_ms:g} ms")


def median_ms(
    sets: Iterable[FrameSet],
    model: WindowModel,
    forecaster: Forecaster,
    clock: Callable[[], float] = time.perf_counter,
    counted: Callable[[TwinState], float] = lambda _: 1.0,
) -> float | None:
    """Median time of model and forecast of a set, ms, by a clock of seconds; None where less than two sets came.

    `counted(state)`: how many times that of a set counts.
    """
    laps = []
    for frames in sets:
        begun = clock()
        state = model.update(frames)
        forecaster.update(state, state.stamp + ASSUMED_LATENCY_NS)
        laps.append(1e3 * (clock() - begun) * counted(state))
    return float(np.median(laps[1:])) if len(laps) > 1 else None


def while_people_work(state: TwinState) -> float:
    """How many times as long such a set will take once people work there; a cell begins with nobody in view."""
    masks = state.moving_masks
    share = sum(np.count_nonzero(mask) for mask in masks) / sum(mask.size for mask in masks)
    return AT_REST - (AT_REST - 1) * min(share / AT_WORK, 1)


@dataclass(frozen=True)
class Sized:
    """A model that has followed the sets of a trial, or begins anew, and what makes sets as wide as it wants them."""

    model: WindowModel
    narrower: Narrower


class Trial:
    """Times the sizes on the first sets that a live twin gets, for a few seconds, and says in one line what it took.

    Counted is the processor time of its thread, what a set takes where nobody else wants the processor, and what it
    would be with people at work: sets of a cell in which nothing moves yet cost half. A twin that takes the place of
    another goes on with the size that one found, at once: its arm waits.
    """

    def __init__(
        self,
        model: ModelParameters,
        forecast: ForecastParameters,
        arm: ArmModel | None,
        grid: Grid,
        budget_ms: float,
        say: Callable[[str], None],
        is_ending: Callable[[], bool] = lambda: False,
        kept: Path | None = None,
    ) -> None:
        """`model`: what a size does not say; `say(line)` tells the user.

        `is_ending()`: whether the twin is to end, and nobody wants to know any more. `kept`: folder in which the size
        is left to the one that takes this twin's place; None: in none.
        """
        self._model = model
        self._forecast = forecast
        self._arm = arm
        self._grid = grid
        self._budget_ms = budget_ms
        self._say = say
        self._is_ending = is_ending
        self._file = None if kept is None else kept / FILE
        self._sets: list[FrameSet] = []
        self._tried: dict[str, Sized] = {}
        self._widest = 0
        """Pixels: sizes of wider images see no more."""
        self._size: str | None = None
        """The one that was taken."""

    def take(self, frames: FrameSet) -> Sized | None:
        """Takes in a set as wide as the cameras' images are prepared; the model to go on with, when they are enough."""
        self._widest = max(view.camera.width for view in frames.views)
        known = None if self._sets else self._left_behind()
        if known is not None:
            self._say(f"size {known}, as it was found before")
            self._size = known
            return self._sized(known)
        self._sets.append(frames)
        if len(self._sets) < TRIED_SETS:
            return None
        choice = best_within(self._budget_ms, self._names(), self._timed_ms)
        if self._is_ending():
            return None  # what it found is of a few sets, or none
        self._take_size(choice)
        is_blind = self._arm is not None and self._sets[0].joints is None
        found, self._tried, self._sets = self._tried[choice.size], {}, self._sets[:1]
        return self._sized(choice.size) if is_blind else found  # it took the arm for ground, which has moved on since

    def smaller(self) -> Sized | None:
        """A model of the next smaller size, that begins anew, where sets take too long; None where there is none."""
        names = self._names()
        place = names.index(self._size) if self._size in names else 0
        if place == 0:
            return None
        reason = f"size {names[place - 1]}: with {names[place]} forecasts came too late for an arm again and again"
        self._take_size(Choice(names[place - 1], reason))
        return self._sized(names[place - 1])

    def _names(self) -> list[str]:
        """Sizes that are tried, from the smallest up."""
        return [name for name, size in SIZES.items() if size.width <= self._widest] or list(SIZES)[:1]

    def _take_size(self, choice: Choice) -> None:
        self._size = choice.size
        self._say(choice.reason)
        if self._file is not None:
            with contextlib.suppress(OSError):  # a full disk must not end the twin too; the next one tries again
                self._file.write_text(choice.size, encoding="ascii")

    def _timed_ms(self, name: str) -> float:
        one = self._tried[name] = self._sized(name)
        forecaster = Forecaster(self._grid, self._forecast, self._arm)
        sets = takewhile(lambda _: not self._is_ending(), self._sets)
        narrowed = (one.narrower.narrowed(frames) for frames in sets)
        clock = time.thread_time  # others may start up meanwhile
        spent = median_ms(narrowed, one.model, forecaster, clock, while_people_work)
        return math.inf if spent is None else spent

    def _sized(self, name: str) -> Sized:
        size = SIZES[name]
        return Sized(WindowModel(size.model(self._model), arm=self._arm), Narrower(size.width))

    def _left_behind(self) -> str | None:
        """The size that a twin before this one found; None where none did."""
        with contextlib.suppress(OSError, UnicodeDecodeError):
            if self._file is not None and (name := self._file.read_text(encoding="ascii")) in SIZES:
                return name
        return None
