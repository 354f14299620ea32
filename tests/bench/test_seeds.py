"""`bench occupancy --seeds`: only what had been seen is asked for, and every scenario gets one line."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from twin_node.bench import seeds
from twin_node.bench.occupancy import OccupancyBench, OccupancyBenchParameters
from twin_node.bench.seeds import run_seeds, table
from twin_node.bench.seen import SeenSurfaces, SeenThings, Sightings
from twin_node.cell import CellSource, Scenario, load_scenario
from twin_node.cli import main
from twin_node.forecast import default_grid
from twin_node.nodes.chain_parameters import ChainParameters
from twin_node.nodes.synchronizer import SynchronizerParameters

AHEAD_NS = 200_000_000
NARROW = ChainParameters(synchronizer=SynchronizerParameters(width=64))


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    """A parcel on the conveyor, rendered small."""
    read = load_scenario("conveyor")
    return replace(read, people=(), duration_s=0.3, sensing=replace(read.sensing, width=64, height=48))


def test_things_are_asked_for_once_seen(scenario: Scenario) -> None:
    source = CellSource(scenario)
    grid = default_grid(np.array(scenario.workspace))
    sightings = Sightings(source.simulated, grid)
    truth = SeenThings(sightings)
    first = next(iter(source))
    later = first.stamp + AHEAD_NS
    unseen = truth.points(later, first.stamp)
    sightings.look(first)
    seen, occupied = truth.points(later, first.stamp), truth.occupied(later)
    too_early, at_once = truth.points(later, first.stamp - 1), truth.points(first.stamp, first.stamp)
    assert seen is not None and unseen is not None and too_early is not None and occupied is not None
    assert len(unseen) == len(too_early) == 0
    assert np.array_equal(seen, occupied)
    assert at_once is not None and len(at_once) > 0
    litres = truth.volume_l(later)
    assert litres == pytest.approx(len(occupied) * 0.008, rel=1e-6)
    parcel_l = 15 * 18 * 10e-3
    assert (
        0.3 * parcel_l < litres < 4 * parcel_l
    )  # it comes in from the grid's side, and voxels are touched, not filled


def test_what_was_in_view_is_asked_for_where_it_has_come_once_it_had_moved(scenario: Scenario) -> None:
    source = CellSource(scenario)
    grid = default_grid(np.array(scenario.workspace))
    sightings = Sightings(source.simulated, grid)
    truth, whole = SeenSurfaces(sightings), SeenThings(sightings)
    sets = list(source)
    for frames in sets:
        sightings.look(frames)
    first, last = sets[0].stamp, sets[-1].stamp
    standing = truth.points(first + AHEAD_NS, first)
    shown, all_of_it = (one.points(last + AHEAD_NS, last) for one in (truth, whole))
    assert standing is not None and shown is not None and all_of_it is not None
    assert len(standing) == 0  # nobody could tell yet that it moves
    assert 0 < len(shown) < len(all_of_it)
    assert {tuple(point) for point in shown} <= {tuple(point) for point in all_of_it}
    bottom = all_of_it[:, 2].min()
    assert np.count_nonzero(shown[:, 2] > bottom) > 0.8 * len(shown)  # no camera looks at it from below


def test_what_is_seen_later_does_not_change_what_is_asked_of_a_forecast(scenario: Scenario) -> None:
    source = CellSource(scenario)
    sightings = Sightings(source.simulated, default_grid(np.array(scenario.workspace)))
    truth, asked = SeenSurfaces(sightings), []
    for frames in source:
        sightings.look(frames)
        asked.append((frames.stamp, truth.points(frames.stamp + AHEAD_NS, frames.stamp)))
    assert any(points is not None and len(points) for _, points in asked[:-1])
    for stamp, points in asked:
        np.testing.assert_array_equal(truth.points(stamp + AHEAD_NS, stamp), points)


def test_a_scenario_gets_one_line_and_the_figures_of_its_runs() -> None:
    bench = run_seeds("conveyor", range(1, 2), OccupancyBenchParameters(chain=NARROW, duration_s=0.75))
    heading, rule, line = table([bench]).splitlines()
    assert heading.count("|") == rule.count("|") == line.count("|")
    assert line.startswith("| conveyor | ")
    figures = json.loads(json.dumps(bench.as_json()))
    assert figures["seeds"] == 1
    assert 0 < figures["ours"]["recall"] <= 1
    assert figures["ours"]["moving_volume_l"] > 0
    assert figures["unseen_not_free"] is None or figures["unseen_not_free"] <= 1
    assert set(figures["persistence_equal_recall"]) == {"volume_l", "reached_in"}
    assert 0 < figures["whole_things"]["ours"]["recall"] <= 1
    assert figures["whole_things"]["ours"]["moving_volume_l"] == figures["ours"]["moving_volume_l"]


def test_seeds_are_scored_from_the_first_one_asked_for_on(
    monkeypatch: pytest.MonkeyPatch, refused: Callable[..., str]
) -> None:
    scored: list[int] = []

    def score(scenario: Scenario, parameters: OccupancyBenchParameters) -> OccupancyBench:
        scored.append(scenario.seed)
        return one

    one = run_seeds("conveyor", range(1, 2), OccupancyBenchParameters(chain=NARROW, duration_s=0.4)).runs[0]
    monkeypatch.setattr(seeds, "_scored", score)
    assert main(["bench", "occupancy", "conveyor", "--seeds", "3", "--first-seed", "15"]) == 0
    assert scored == [15, 16, 17]
    assert "--first-seed: expected --seeds N beside it" in refused(
        "bench", "occupancy", "some.mcap", "--first-seed", "15"
    )


@pytest.mark.parametrize("name", ["reach_in", "all"])
def test_a_scenarios_name_without_seeds_is_told_what_is_missing(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "occupancy", name]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert line == f"twin_node: error: {name}: expected a log, found a scenario's name; add --seeds N to simulate it"


def test_a_scenario_that_is_none_is_one_line(refused: Callable[..., str]) -> None:
    assert "no_such_scenario" in refused("bench", "occupancy", "no_such_scenario", "--seeds", "1")


@pytest.mark.parametrize(
    "given",
    [["--start-offset", "1"], ["--rig", "rig.yaml"], ["--remap", "/a:=/b"], ["--max-rate", "5"], ["--hue", "8"]],
)
def test_options_of_logs_are_refused_beside_seeds(given: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    """Figures at the scenario's own rate would be taken for those at the rate that was asked for."""
    assert main(["bench", "occupancy", "reach_in", "--seeds", "1", *given]) == 2
    told = capsys.readouterr().err
    assert f"leave out {given[0]}" in told and told.count("\n") == 1
