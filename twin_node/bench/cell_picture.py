"""Draws what `bench cell` found: work per scenario and policy, and the distances of one run."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from matplotlib.figure import Figure

from twin_node.bench.cell import CaseResult, CellBenchParameters
from twin_node.bench.cell_case import PERFECT, WORST_CASE, CellCase, Policy
from twin_node.bench.cell_scores import distances_to_people
from twin_node.bench.results_folder import save_chart
from twin_node.cell.scenario_file import load_scenario

if TYPE_CHECKING:
    from matplotlib.axes import Axes

BARS = ("present_only", "worst_case", "ours", "unlimited")
"""Policies that get a bar each; more work towards the right is only worth something without contacts."""
COLOURS = {"present_only": "#b9b9b9", "worst_case": "#c8553d", "ours": "#2a6f97", "unlimited": "#74a892"}


def draw(results: Sequence[CaseResult], parameters: CellBenchParameters, folder: Path) -> Path:
    """Writes `cell.png` into a folder, which is made where it is missing; the first result's scenario is run again.

    That is with perfect perception, as late as the figures have it: a twin in the loop is not run again.

    Raises `BenchError` where the folder cannot be written.
    """
    figure = Figure(figsize=(12, 9), layout="constrained")
    rows = figure.subplots(3, 1, height_ratios=(2, 1.2, 1.2))
    _draw_work(rows[0], results)
    first = results[0]
    scenario = next(s for s in map(load_scenario, parameters.scenarios) if s.name == first.scenario)
    latency_ms = parameters.latency_ms if first.timing is None else first.timing.usual_ms
    case = CellCase(scenario.with_seed(first.seed), latency_ms, parameters.loop)
    _draw_run(rows[1], rows[2], case, PERFECT, "perfect perception" if parameters.twin else "ours")
    _draw_run(rows[1], rows[2], case, WORST_CASE, WORST_CASE.name)
    rows[1].set_title(f"{first.scenario}, seed {first.seed}", loc="left")
    return save_chart(figure, folder, "cell")


def _draw_work(axes: Axes, results: Sequence[CaseResult]) -> None:
    """A group of bars per scenario, the number of contacts above each."""
    names = list(dict.fromkeys(result.scenario for result in results))
    width = 0.8 / len(BARS)
    for column, policy in enumerate(BARS):
        for row, name in enumerate(names):
            runs = [result for result in results if result.scenario == name]
            work = float(np.mean([result.work[policy] for result in runs]))
            contacts = sum(result.outcomes[policy].contacts for result in runs)
            place = row + (column - (len(BARS) - 1) / 2) * width
            axes.bar(place, work, 0.95 * width, color=COLOURS[policy], label=policy if row == 0 else None)
            if contacts:
                axes.annotate(f"{contacts} hit", (place, work), ha="center", va="bottom", fontsize=8)
    axes.set_xticks(range(len(names)), names)
    axes.set_ylabel("work, share of the unobstructed cycle")
    axes.set_ylim(0, 1.05)
    axes.legend(ncols=len(BARS), loc="lower right", bbox_to_anchor=(1, 1), frameon=False)  # bars reach to the top


def _draw_run(distance: Axes, speed: Axes, case: CellCase, policy: Policy, label: str) -> None:
    """Distance to the nearest person and the arm's speed over time."""
    record = case.run(policy)
    seconds = (record.stamps - case.scenario.start_ns) * 1e-9
    colour = COLOURS["ours" if policy is PERFECT else policy.name]
    distance.plot(seconds, distances_to_people(case, record, case.joints(record)), color=colour, label=label)
    speed.plot(seconds, record.shares, color=colour, label=label)
    distance.axhline(0, color="black", linewidth=0.8)
    distance.set_ylabel("distance to people, m")
    distance.legend(frameon=False)
    speed.set_ylabel("speed, share of the program's")
    speed.set_xlabel("s")
