"""What the report holds a run's forecasts against."""

from __future__ import annotations

import gc
import tracemalloc
import weakref
from collections.abc import Callable, Iterator, Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from twin_node.bag import open_log
from twin_node.cell import Scenario, write_log
from twin_node.cell.actors import Body, Part
from twin_node.cell.scenario import CameraSpec, Sensing
from twin_node.forecast import ForecastParameters
from twin_node.forecast.comparison import Comparison
from twin_node.forecast.sights import CarvingParameters
from twin_node.messages import convert
from twin_node.model import ModelParameters, SeedParameters
from twin_node.nodes.chain_parameters import ChainParameters
from twin_node.nodes.log_source import LogSession
from twin_node.nodes.replay import replay
from twin_node.nodes.report import foresight
from twin_node.nodes.report.foresight import score_forecasts
from twin_node.nodes.spool import Tick
from twin_node.nodes.synchronizer import SynchronizerParameters
from twin_node.nodes.truth import truth_of
from twin_node.scene import Occupancy, TwinState


def test_baselines_stand_on_the_evidence_of_the_run(cell_log: Callable[..., Path]) -> None:
    """All forecasts of nothing that moves block the same unseen space, which a wide margin of depth makes large."""
    chain = ChainParameters(
        synchronizer=SynchronizerParameters(width=64, max_rate_hz=10),
        model=ModelParameters(seed=SeedParameters(steps=2)),
        forecast=ForecastParameters(carving=CarvingParameters(depth_margin=0.1)),
    )
    with LogSession(cell_log(0.5)) as session, replay(session, chain, rate=None, keep_ticks=True) as run:
        assert run.spool is not None
        scores = score_forecasts(run.spool, session.log, run.parameters, 0).methods
        others = score_forecasts(run.spool, session.log, ChainParameters(), 0).methods["persistence"]
    assert scores["ours"].moving_volume_l == scores["persistence"].moving_volume_l == 0
    assert scores["ours"].volume_l == scores["persistence"].volume_l != others.volume_l


def test_nothing_is_compared_right_after_a_gap(cell_log: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """The twin has followed meanwhile, and the baselines have not: of constant velocity they knew none."""
    chain = ChainParameters(
        synchronizer=SynchronizerParameters(width=64, max_rate_hz=15),
        model=ModelParameters(seed=SeedParameters(steps=2)),
    )
    compared: list[int] = []

    class Watched(Comparison):
        def add(self, state: TwinState, forecasts: Mapping[str, Occupancy]) -> None:
            compared.extend([state.stamp] if forecasts else [])
            super().add(state, forecasts)

    monkeypatch.setattr(foresight, "Comparison", Watched)
    with LogSession(cell_log(0.9)) as session, replay(session, chain, rate=None, keep_ticks=True) as run:
        ticks = list(run.spool or ())
        hidden, late = [tick.stamp for tick in ticks[2:4]], ticks[4].stamp
        cut = (replace(tick, is_after_gap=tick.stamp == late) for tick in ticks if tick.stamp not in hidden)
        score_forecasts(cut, session.log, run.parameters, 0)
    stamps = [tick.stamp for tick in ticks]
    assert compared == [*stamps[:2], *(stamp for stamp in stamps if stamp >= late + 200_000_000)]


def test_a_run_is_never_held_whole(cell_log: Callable[..., Path]) -> None:
    """It is on the disk because it is too large: all sets in which anything moved were in memory for six pictures."""
    chain = ChainParameters(
        synchronizer=SynchronizerParameters(width=64, max_rate_hz=15),
        model=ModelParameters(seed=SeedParameters(steps=2)),
    )
    ticks: list[weakref.ref[Tick]] = []
    alive: list[int] = []
    with LogSession(cell_log(2.4)) as session, replay(session, chain, rate=None, keep_ticks=True) as run:
        spool = run.spool
        assert spool is not None

        def counted() -> Iterator[Tick]:
            for tick in spool:
                ticks.append(weakref.ref(tick))
                yield tick
                gc.collect()  # of what has come since, which is all that the ticks are in
                alive.append(sum(known() is not None for known in ticks))

        gc.freeze()  # to go through all that was there before takes half a second
        try:
            found = score_forecasts(counted(), session.log, run.parameters, 2)
        finally:
            gc.unfreeze()
    assert len(ticks) >= 25 and len(found.recalls) > 15
    assert len(found.examples) == 2
    assert max(alive) <= 2


def test_the_truth_of_a_long_log_takes_little_memory(tmp_path: Path) -> None:
    """The centres of all voxels were held: of an hour of the demo, 8 GB."""
    block = Body("block", (Part(size=(0.3, 0.3, 0.3), position=(0.5, 0.0, 0.4)),))
    cell = Scenario(bodies=(block,), cameras=(CameraSpec("one"),), sensing=Sensing(16, 12), duration_s=0.5)
    write_log(cell, tmp_path / "cell.mcap")
    with open_log(tmp_path / "cell.mcap") as log:
        told = [convert.occupancy_from_message(item.message) for item in log.messages(["/truth/occupancy"])]
        tracemalloc.start()
        try:
            truth = truth_of(log)
            held = tracemalloc.get_traced_memory()[0]
        finally:
            tracemalloc.stop()
    centres = [one.grid.centers(one.layers[0].indices) for one in told]
    assert len(centres) == 15
    assert held < sum(one.nbytes for one in centres) / 3
    for one, points in zip(told, centres, strict=True):
        np.testing.assert_array_equal(truth.points(one.stamp, one.stamp), points)
        assert truth.volume_l(one.stamp) == pytest.approx(8e-3 * len(points))
