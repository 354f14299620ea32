"""Records of how forecasts went, node by node."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.experts import EXPERT_NAMES
from twin_node.scene import Float64

Rows = NDArray[np.int64]

_UNTRIED = np.array([0.17, 0.16, 0.13, 0.24, 0.12, 0.3])
"""Errors ascribed to experts before they are judged, m: theirs on human motion at 200 ms (`bench forecast`)."""
USUAL_ERROR = 0.12
"""Error ascribed to their mixture, m: that of the best."""
RECORD_S = 0.65
"""Time constant of the experts' records, s."""
RISE_S, FALL_S = 0.05, 0.6
"""Time constants in which the error of the mixture grows and shrinks, s."""


@dataclass
class Records:
    """What is known of each node's forecasts; arrays are contiguous, for `reckoning.reckon` changes them in place."""

    squared: Float64 = field(default_factory=lambda: np.zeros((len(EXPERT_NAMES), 0)))
    """[E, M] recent mean square errors of the experts, m^2."""
    errors: Float64 = field(default_factory=lambda: np.zeros(0))
    """[M] recent error of the mixture, m: quick to grow, slow to shrink."""
    born: Float64 = field(default_factory=lambda: np.zeros(0))
    """[M] s when the node was first known."""
    began: Float64 = field(default_factory=lambda: np.zeros(0))
    """[M] s when the record began: then, or when the node began something new."""
    turned: Float64 = field(default_factory=lambda: np.zeros(0))
    """[M] s when the node last turned back against its forecast; -inf if never."""
    judged: Rows = field(default_factory=lambda: np.zeros(0, np.int64))
    """[M] forecasts in the record."""

    def inherited(self, rows: Rows, time: float) -> Records:
        """The records of nodes that take over those in `rows` [M']; untried ones for -1."""
        new = rows < 0
        if len(self.errors) == 0:
            count = len(rows)
            squared = np.tile(_UNTRIED[:, None] ** 2, (1, count))
            born, began = np.full((2, count), time)
            never = np.full(count, -np.inf)
            return Records(squared, np.full(count, USUAL_ERROR), born, began, never, np.zeros(count, np.int64))
        return Records(
            np.where(new, _UNTRIED[:, None] ** 2, self.squared.take(rows, axis=1)),
            np.where(new, USUAL_ERROR, self.errors[rows]),
            np.where(new, time, self.born[rows]),
            np.where(new, time, self.began[rows]),
            np.where(new, -np.inf, self.turned[rows]),
            np.where(new, 0, self.judged[rows]),
        )

    def weigh(self, known: Rows, single: Float64, elapsed_s: float) -> None:
        """Enters errors of the experts [E, n] in metres, as if at the horizon, for the nodes `known` [n].

        Errors at all knots count: the earlier ones tell sooner which expert is right after motion has changed. Those of
        what no expert foresaw (within the bound then) are not to be entered: each errs by chance there, and by so much
        that one which was merely unlucky would not be believed for a second.
        """
        rate = 1 - np.exp(-elapsed_s / RECORD_S)
        self.squared[:, known] += rate * (single**2 - self.squared[:, known])

    def enter(self, known: Rows, wrong: Float64, elapsed_s: float) -> None:
        """Enters errors of the mixture [n] in metres at the horizon for the nodes `known` [n]."""
        before = self.errors[known]
        first = 1 / (1 + self.judged[known])  # an average of what there is, until there is more than records hold
        rate = np.maximum(1 - np.exp(-elapsed_s / np.where(wrong > before, RISE_S, FALL_S)), first)
        self.errors[known] = before + rate * (wrong - before)
        self.judged[known] += 1
