"""How much of what came true had been foreseen 200 ms before, beside the baselines."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Mapping
from dataclasses import asdict, dataclass, field
from typing import Any

import numpy as np

from twin_node.bag import LogReader
from twin_node.forecast import BaselineForecaster
from twin_node.forecast.comparison import Comparison, Score
from twin_node.forecast.score import contains
from twin_node.nodes.chain_parameters import ChainParameters
from twin_node.nodes.spool import Tick
from twin_node.nodes.truth import OBSERVED_NS, truth_of
from twin_node.scene import HORIZONS_NS, Grid, Occupancy, UInt32, View
from twin_node.thinning import Thinning

OURS = "ours"
BLIND_NS = HORIZONS_NS[-1]
"""For so long after a gap no forecast is compared, ns: the twin has followed all along, but the baselines have yet to
see how things move."""


@dataclass(frozen=True)
class ForecastExample:
    """A forecast, an image of the time it was for, and what was seen to move then: for the pictures."""

    view: View
    grid: Grid
    foreseen: UInt32
    seen: UInt32


@dataclass(frozen=True)
class Foresight:
    """Scores of ours and the baselines, 200 ms ahead."""

    methods: Mapping[str, Score] = field(default_factory=dict)
    truth: str = ""
    """What the truth was taken from."""
    examples: tuple[ForecastExample, ...] = ()
    recalls: tuple[tuple[int, float], ...] = ()
    """Stamp (ns) and the share of the voxels seen to move then that had been foreseen."""

    def figures(self) -> dict[str, Any]:
        """As JSON values under the stable names."""
        ours = asdict(self.methods[OURS]) if OURS in self.methods else dict.fromkeys(Score.__dataclass_fields__)
        baselines = {name: asdict(scores) for name, scores in self.methods.items() if name != OURS}
        return {"horizon_s": HORIZONS_NS[-1] * 1e-9, **ours, "truth": self.truth, "baselines": baselines}


def score_forecasts(ticks: Iterable[Tick], log: LogReader, chain: ChainParameters, examples: int) -> Foresight:
    """Scores every forecast whose time came within the run; keeps `examples` of them, evenly spread, for pictures.

    The truth is the log's exact occupancy where it has one, else what the twin saw to move when the time had come. The
    baselines, and what the twin saw, rest on the parameters and the arm of the `chain` that made the forecasts. Those
    right after a gap are not scored (`BLIND_NS`).
    """
    truth = truth_of(log)
    comparison = Comparison(truth, "persistence")
    baselines: BaselineForecaster | None = None
    due: deque[Occupancy] = deque()
    shown: Thinning[ForecastExample] = Thinning(examples)
    recalls: list[tuple[int, float]] = []
    sees_from = 0
    for tick in ticks:
        if tick.is_after_gap:
            sees_from = tick.stamp + BLIND_NS
        if tick.state is None or tick.occupancy is None:
            continue
        ours = tick.occupancy
        if baselines is None:
            baselines = BaselineForecaster(ours.grid, chain.forecast.carving, chain.forecast.static, chain.arm.arm())
        others = baselines.update(tick.state, ours.publish_stamp)
        seen = others.persistence.layers[0].indices
        truth.observe(tick.state, others.persistence)
        comparison.add(tick.state, {OURS: ours, **vars(others)} if tick.stamp >= sees_from else {})
        foreseen = _come_due(due, tick.stamp)
        if foreseen is not None and len(seen):
            held = contains(ours.grid, foreseen.layers[-1].indices, seen.astype(np.int64))
            recalls.append((tick.stamp, float(held.mean())))
            shown.add(ForecastExample(tick.frames.views[0], ours.grid, foreseen.layers[-1].indices, seen))
        due.append(ours)
    return Foresight(comparison.scores(), truth.source, tuple(shown.picked()), tuple(recalls))


def _come_due(due: deque[Occupancy], stamp: int) -> Occupancy | None:
    """The newest waiting forecast for about `stamp`, ns; it and older ones no longer wait."""
    found = None
    while due and due[0].publish_stamp + HORIZONS_NS[-1] <= stamp + OBSERVED_NS:
        found = due.popleft()
    if found is None or found.publish_stamp + HORIZONS_NS[-1] < stamp - OBSERVED_NS:
        return None
    return found
