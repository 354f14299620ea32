"""The best way to see a node as two bodies."""

from __future__ import annotations

import numpy as np
from scipy.spatial import cKDTree

from twin_node.model.kernels import kernels
from twin_node.model.node_requests import HalvesRequest
from twin_node.model.velocity_equations import (
    LOOSE,
    PARAMETERS,
    RARELY,
    USUAL,
    VelocityEquations,
    judge,
    velocities_of,
)
from twin_node.native_library import addresses_of
from twin_node.scene import Bool, Float64

LEAST = PARAMETERS
"""Independent observations of a part that is told from the rest of its node: as many as its motion has parameters."""
SURE = 1.0
"""Nats by which one part must explain a cell better for it to be known whose it is."""
BETTER = 12.0
"""Nats by which two other bodies must explain what was said better than those that are suspected."""
ROUNDS = 3
"""Times that cells are dealt out again between two parts."""
BESIDE = 6
"""Neighbours of a cell that are asked whose they are; a quarter of all cells at most."""
MIXED = 0.4
"""Share of neighbours that may be the other part's, in units of what chance would give: errors of the flow, which views
share, cut bodies at 0.5 to 0.6 through and through, and what parts has 0 to 0.3."""


def halves_of(said: VelocityEquations, centres: Float64, misfit: float, suspected: Bool | None = None) -> Bool | None:
    """[c] which of c cells at `centres` [c, 3] m are the smaller of the two bodies that explain best what was said.

    None where there are not enough observations, or where those that are `suspected` [c] explain nearly as much of it.
    Cells are dealt out along the axes of the body and by their own motions, then time and again to the part whose
    velocity explains them better (Lloyd's algorithm with the flow's own errors, of variance `misfit`, as distance).
    Parts that do not lie apart are none.
    """
    library = kernels()
    if library is None:
        return halves_reference(said, centres, misfit, suspected)
    given = [np.ascontiguousarray(values, np.float64) for values in (*vars(said).values(), centres, USUAL, LOOSE)]
    known = None if suspected is None else np.ascontiguousarray(suspected)
    second, found = np.empty(len(said), bool), np.zeros(1, bool)
    library.run(
        HalvesRequest(
            len(said),
            *addresses_of(*given, known),
            *(misfit, LEAST, RARELY, BETTER, MIXED, ROUNDS, BESIDE),
            *addresses_of(second, found),
        )
    )
    return second if found[0] else None


def halves_reference(
    said: VelocityEquations, centres: Float64, misfit: float, suspected: Bool | None = None
) -> Bool | None:
    """The same in NumPy: the reference of the compiled kernel."""
    weight = said.counts
    if len(said) < 2 or weight.sum() < 2 * LEAST:
        return None
    middle = (weight[:, None] * centres).sum(0) / weight.sum()
    own = said.about(np.broadcast_to(middle, centres.shape))
    second = _dealt(own, centres - middle, weight)
    for _ in range(ROUNDS):
        second = _dealt_again(own, second)
    if suspected is not None:
        second = np.concatenate([second, suspected[None]])
    parts = _parts(own, second)
    tries = len(second)
    counts = parts.counts.reshape(2, tries)
    enough = (counts > LEAST).all(0) & lie_apart(centres, second)
    if not enough.any():
        return None
    two = judge(parts.over(np.full(2 * tries, misfit)), np.zeros((2 * tries, 3))).best.reshape(2, tries).sum(0)
    two = np.where(enough, two, -np.inf)
    best = int(two.argmax())
    if suspected is not None and two[best] - two[-1] <= BETTER:
        return None
    smaller: Bool = second[best] if counts[1, best] <= counts[0, best] else ~second[best]
    return smaller


def lie_apart(centres: Float64, second: Bool) -> Bool:
    """[t] whether either part of each try `second` [t, c] of cells at `centres` [c, 3] m is in one place.

    Bodies are in one piece each, so a cell's neighbours are mostly of its own part.
    """
    beside = min(BESIDE, len(centres) // 4)
    if beside == 0:
        return np.ones(len(second), bool)
    neighbours = cKDTree(centres).query(centres, beside + 1)[1][:, 1:]
    others = (second[:, neighbours] != second[..., None]).mean((1, 2))
    share = second.mean(1)
    apart: Bool = others <= MIXED * 2 * share * (1 - share)
    return apart


def redealt(said: VelocityEquations, centres: Float64, second: Bool, misfit: float) -> Bool:
    """[c] the cells of two parts dealt out once more, each to the part that explains it better.

    `second` [c] says which are the second part's so far. Cells that say little go where the nearest that say enough do.
    """
    middle = centres.mean(0)
    own = said.about(np.broadcast_to(middle, centres.shape))
    errors = _errors(own, second[None])[:, 0] / (2 * misfit)
    better: Bool = errors[1] < errors[0]
    sure = np.abs(errors[1] - errors[0]) > SURE
    if not (sure & better).any() or not (sure & ~better).any():
        return second
    nearest = cKDTree(centres[sure]).query(centres)[1]
    dealt: Bool = better[sure][nearest]
    return dealt


def _dealt(own: VelocityEquations, arms: Float64, weight: Float64) -> Bool:
    """[4, c] first guesses: either side of the middle along each of the body's axes, and along its cells' motions."""
    axes = _axes(arms * np.sqrt(weight)[:, None])
    whole = own.summed(np.zeros(len(own), np.int64), 1)
    velocity = velocities_of(whole, np.zeros((1, 3)))[0]
    rest = own.g - (own.H @ velocity[:, None])[..., 0]
    pulls = rest[:, :3] / np.sqrt(np.maximum(np.trace(own.H[:, :3, :3], axis1=1, axis2=2), 1e-12))[:, None]
    way = _axes(pulls)[:1]
    along = np.concatenate([(arms @ axes.T).T, (pulls @ way.T).T])
    guesses: Bool = along > np.array([[_median(row, weight)] for row in along])
    return guesses


def _axes(places: Float64) -> Float64:
    """[k, 3] axes of `places` [c, 3], the longest first; of each the largest component is positive."""
    axes = np.linalg.svd(places, full_matrices=False)[2]
    largest = np.take_along_axis(axes, np.abs(axes).argmax(1)[:, None], 1)
    signed: Float64 = np.copysign(1.0, largest) * axes
    return signed


def _dealt_again(own: VelocityEquations, second: Bool) -> Bool:
    """[t, c] each cell to the part whose velocity leaves the smaller error."""
    errors = _errors(own, second)
    dealt: Bool = errors[1] < errors[0]
    return dealt


def _errors(own: VelocityEquations, second: Bool) -> Float64:
    """[2, t, c] squared errors of each cell by the velocity of the first and of the second part of each try [t, c].

    Less those of a cell that does not move.
    """
    tries = len(second)
    velocities = velocities_of(_parts(own, second), np.zeros((2 * tries, 3)))
    pairs = (velocities[:, :, None] * velocities[:, None, :]).reshape(2 * tries, -1)
    quadratic = pairs @ own.H.reshape(len(own), -1).T  # what `einsum` finds out anew at every call
    errors: Float64 = (quadratic - 2 * velocities @ own.g.T).reshape(2, tries, len(own))
    return errors


def _parts(own: VelocityEquations, second: Bool) -> VelocityEquations:
    """[2 t] what was said of the first and of the second parts of each try [t, c]."""
    return own.gathered(np.concatenate([~second, second]))


def _median(values: Float64, weight: Float64) -> float:
    """The weighted median of values [c]."""
    order = np.argsort(values, kind="stable")
    reached = np.cumsum(weight[order])
    return float(values[order[np.searchsorted(reached, reached[-1] / 2)]])
