"""The stability suite's chart: its rows are those of the table, its bars end at the ticks that its axis names."""

from __future__ import annotations

from dataclasses import replace

import matplotlib.colors
import numpy as np
import pytest
from matplotlib.axes import Axes

from twin_node.bench.stability.chart import COLOURS, TITLES, drawn
from twin_node.bench.stability.failures import FAILURES
from twin_node.bench.stability.scores import Pooled
from twin_node.bench.stability.suite import METHODS, QUICK, Level, Stability

HOLDS = Pooled(1.0, 1.0, 0.0, 10.0, 0.0, 0, 20.0)
FAILS = replace(HOLDS, recall=0.5, psnr_moving_db=10.0)


def made_up(**gives_way: int | None) -> Stability:
    """A suite of these failures in which every method gives way at a level's index, or (None) never."""
    failures = {
        name: [
            Level(level, dict.fromkeys(METHODS, FAILS if at is not None and index >= at else HOLDS), 1.0, ())
            for index, level in enumerate(FAILURES[name].levels)
        ]
        for name, at in gives_way.items()
    }
    return Stability(failures, None, None, {}, replace(QUICK, names=tuple(failures)))


def axes_of(found: Stability) -> Axes:
    (axes,) = drawn(found).axes
    return axes


def ends(axes: Axes, row: int) -> list[float]:
    """Where the bars of a row end, in the order of the methods."""
    rows = [bar for bar in axes.patches if bar.get_width() > 0 and bar.get_x() == 0]
    within = [bar for bar in rows if abs(bar.get_y() + bar.get_height() / 2 - row) < 0.4]
    found = {matplotlib.colors.to_hex(bar.get_facecolor()): bar.get_x() + bar.get_width() for bar in within}
    return [found[colour] for colour in COLOURS]


@pytest.mark.parametrize("name", ["fast_motion", "reflective", "hours"])
def test_bars_end_at_the_ticks_that_name_where_a_method_gives_way(name: str) -> None:
    hardest = len(FAILURES[name].levels) - 1
    for at, tick in ((hardest, "at the hardest level"), (None, "never")):
        axes = axes_of(made_up(**{name: at}))
        places = dict(zip([label.get_text() for label in axes.get_xticklabels()], axes.get_xticks(), strict=True))
        np.testing.assert_allclose(ends(axes, 0), [places[tick]] * len(TITLES))
    at_once = ends(axes_of(made_up(**{name: 0})), 0)
    assert 0 < max(at_once) < 0.01  # to be seen at all
    between = [ends(axes_of(made_up(**{name: at})), 0)[0] for at in range(hardest + 1)]
    np.testing.assert_allclose(np.diff(between), 1 / hardest, atol=0.01)


def test_every_failure_that_was_run_has_its_row_the_undisturbed_one_too() -> None:
    alone = axes_of(made_up(undisturbed=2))
    assert [label.get_text() for label in alone.get_yticklabels()] == ["nothing wrong: a box turns\n0.2, 0.5, 0.8 m/s"]
    np.testing.assert_allclose(ends(alone, 0), 1.0)
    both = axes_of(made_up(undisturbed=None, hours=2))
    assert len(both.get_yticklabels()) == 2
    np.testing.assert_allclose(ends(both, 1), 1.0)


def test_a_failure_of_one_level_is_given_way_to_at_once_or_never() -> None:
    found = made_up(reflective=3)
    for at, end in ((FAILS, 0.0), (HOLDS, axes_of(found).get_xticks()[-1])):
        level = replace(found.failures["reflective"][3], methods=dict.fromkeys(METHODS, at))
        np.testing.assert_allclose(ends(axes_of(replace(found, failures={"reflective": [level]})), 0), end, atol=0.01)
