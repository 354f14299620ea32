"""How much of what the cameras now see to move lies inside the forecast that was made for now."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.margin import Margin
from twin_node.forecast.moving_surface import Moving, moving_surface, places_of
from twin_node.forecast.parts import Parts
from twin_node.forecast.tables import CameraTable, RigTables
from twin_node.scene import Bool, TwinState


@dataclass(frozen=True)
class Held:
    """What was seen, and how much of it was foreseen: pixels, or points of measured surfaces."""

    seen: int
    covered: int
    measured: int = 0
    """Points that depth cameras measured of what shows to move, in what moves by all that is seen or not."""
    agreed: int = 0
    """Of these, those in what moves by all that is seen."""

    @property
    def share(self) -> float:
        """Of what was seen, what was foreseen; asked only where something was seen."""
        return self.covered / self.seen


@dataclass(frozen=True)
class Watch:
    """What the forecaster can tell of its own failures, as of the last judgement."""

    unforeseen: float = 0.0
    """Share of all that moves now, new or not, that lay outside the forecast made for now."""
    agreement: float = 1.0
    """Running mean share of the measured moving surface that no camera sees past."""
    weighed: int = 2
    """Judgements in that mean, of two at the start that all agrees."""

    def after(self, all_: Held) -> Watch:
        """With a judgement of everything that moves now."""
        unforeseen = 1 - all_.covered / all_.seen if all_.seen >= FEWEST else 0.0
        if all_.measured < FEWEST:
            return replace(self, unforeseen=unforeseen)
        weighed = min(self.weighed + 1, AGREEMENT_JUDGEMENTS)
        agreement = self.agreement + (all_.agreed / all_.measured - self.agreement) / weighed
        return Watch(unforeseen, agreement, weighed)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader must know; stable as long as nothing changes."""
        told = ((self.unforeseen > MOST_UNFORESEEN, _UNFORESEEN), (self.agreement < LEAST_AGREEMENT, _AT_ODDS))
        return tuple(line for is_so, line in told if is_so)


_UNFORESEEN = (
    "forecast: what moves now was not foreseen: it is new, or faster or more sudden than what the bound was learnt "
    "from; keep clear until this ends"
)
_AT_ODDS = (
    "forecast: cameras measure what moves where others see past it: look for mirrors and glass, clocks that are off, "
    "and cameras out of place"
)
FEWEST = 30
"""Pixels or points below which nothing is told by their shares."""
MOST_UNFORESEEN = 0.2
"""Share from which what moves counts as unforeseen: on recorded people and arms 6 % at most once they are in motion."""
LEAST_AGREEMENT = 0.55
"""Share below which cameras contradict each other: 0.7 to 1 where all is well, 0.4 on a mirror."""
AGREEMENT_JUDGEMENTS = 6
"""Judgements, 50 ms and more apart, that agreement is averaged over: things come into view piece by piece."""


class Judgement:
    """One set of images against the forecast that was made for its time: of all that moves, or of some of it.

    A camera with depth judges by the points of the moving surface that it measures. One without judges by its pixels:
    in space the hull holds more than what moves, and flickers.
    """

    def __init__(
        self, state: TwinState, margin: Margin, tables: RigTables, forecast: NDArray[np.int64], parts: Parts
    ) -> None:
        """`forecast` [n]: its voxels in the inner grid, flat indices in rising order.

        `parts`: what moves now; flat indices in the outer grid, in rising order, and coordinates in the inner one.
        """
        self._parts, self._blocks, self._margin = parts, tables.blocks, margin
        dims = np.array(margin.inner.dims)[:, None]
        self._is_inner: Bool = np.all((parts.places >= 0) & (parts.places < dims), axis=0)
        """[n] voxels of the parts that forecasts hold: none is made of the rim."""
        self._told: dict[bytes, Held] = {}
        """By who was chosen."""
        seen = list(zip(state.frames.views, state.moving_masks, strict=True))
        self._measured = [Moving(view, mask) for view, mask in seen if view.depth is not None]
        self._surface = moving_surface(self._measured, margin, parts, forecast)
        self._images: list[_Image] = []
        if len(self._measured) < len(seen):
            expected = tables.blocks.locate(margin.outward(forecast))
            flat = [(tables.of(view.camera), mask) for view, mask in seen if view.depth is None]
            self._images = [_Image(table, mask, table.image_of(expected)) for table, mask in flat]

    def of(self, chosen: Bool) -> Held:
        """How much of the parts `chosen` [M], all of which could be foreseen, was.

        Asked of several choices, which are the same where nothing is new.
        """
        key = chosen.tobytes()
        if key not in self._told:
            self._told[key] = self._of(chosen)
        return self._told[key]

    def of_all(self, sees_past: Callable[[NDArray[np.int64]], Bool]) -> Held:
        """How much of all that moves was foreseen, and where cameras contradict each other.

        `sees_past` tells of voxels [n], flat indices in the outer grid, which some camera sees past. It is asked only
        where it may matter: masks are wider than things, and where a thing is small in the image of the only camera
        that measures it, most of what that measures in them is the ground.
        """
        held = self.of(np.ones(self._parts.count, np.bool_))
        if held.agreed >= LEAST_AGREEMENT * held.measured:
            return held
        unexplained = places_of(self._measured, self._margin)[self._surface.parts < 0]
        return replace(held, measured=held.agreed + int(np.count_nonzero(sees_past(unexplained))))

    def _of(self, chosen: Bool) -> Held:
        surface = self._surface
        explained = np.append(chosen, False)[surface.parts]
        agreed, pixels = int(np.count_nonzero(explained)), 0
        covered = int(np.count_nonzero(explained & surface.foreseen))
        if self._images:
            here = self._blocks.locate(self._parts.indices[chosen[self._parts.labels] & self._is_inner])
            for image in self._images:
                shown = image.moving & image.table.image_of(here)
                pixels += int(np.count_nonzero(shown))
                covered += int(np.count_nonzero(shown & image.foreseen))
        return Held(agreed + pixels, covered, len(explained), agreed)


@dataclass(frozen=True)
class _Image:
    """What a camera without depth shows."""

    table: CameraTable
    moving: Bool
    """[H, W]."""
    foreseen: Bool
    """[H, W] where the forecast projects."""
