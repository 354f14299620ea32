"""What the flow says about the velocities of bodies, as normal equations that add up over cells and over sets."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.model.kernels import kernels
from twin_node.model.node_requests import JudgeRequest, MoveRequest, SumRequest, VelocityRequest
from twin_node.native_library import addresses_of
from twin_node.scene import Bool, Float64

SPEED, TURN = 0.3, 1.0
"""m/s and rad/s (1 sigma) that a body is expected to move at: a reaching hand's and a turning wrist's."""
LOOSE_TURN = 2.0
"""rad/s (1 sigma) that turns are held to where they are measured: a body of a hand's size tells little of its turning,
and the usual turn draws what it does tell to rest."""
USUAL, LOOSE = np.array([SPEED] * 3 + [TURN] * 3), np.array([SPEED] * 3 + [LOOSE_TURN] * 3)
"""[6] m/s and rad/s, both as 1 sigma of each parameter."""
CORRELATED = 4.0
"""Observations of a node that say the same: the flow is sought in patches of 8 pixels."""
PARAMETERS = 6
"""Of a rigid motion."""
RARELY = 2.0
"""Nats that it takes for part of what a node carries to rest beside what moves: it has a node because it moved."""
LEAST_MISFIT = 0.02
"""Smallest variance of the errors in units of what the flow claims: a seventh of its sigma, of images without noise."""
SHARED_OBSERVATIONS = 20.0
"""Independent observations that the misfit of all bodies counts for in that of one."""


@dataclass(frozen=True)
class VelocityEquations:
    """Of n bodies: squared errors as a quadratic in their velocity, of the point at the origin of `base_link`."""

    H: Float64
    """[n, 6, 6] per (m/s, rad/s) squared."""
    g: Float64
    """[n, 6]."""
    squares: Float64
    """[n] of a body that does not move."""
    counts: Float64
    """[n] independent observations."""

    def __len__(self) -> int:
        return len(self.squares)

    def of(self, rows: NDArray[np.int64]) -> VelocityEquations:
        """Those in `rows` [k]."""
        return VelocityEquations(self.H[rows], self.g[rows], self.squares[rows], self.counts[rows])

    def plus(self, other: VelocityEquations) -> VelocityEquations:
        """Each with the other's in its row, as if both were one body."""
        return VelocityEquations(
            self.H + other.H, self.g + other.g, self.squares + other.squares, self.counts + other.counts
        )

    def summed(self, bodies: NDArray[np.int64], count: int) -> VelocityEquations:
        """Those of `count` bodies, of which each of the n is one of a part of: `bodies` [n]."""
        total = nothing(count)
        for name, values in vars(total).items():
            add_up(vars(self)[name], bodies, values)
        return total

    def gathered(self, belongs: Bool) -> VelocityEquations:
        """Those of k bodies, of which each of the n is a part where `belongs` [k, n] says so."""
        share = belongs.astype(np.float64)
        H = (share @ self.H.reshape(len(self), -1)).reshape(-1, PARAMETERS, PARAMETERS)
        return VelocityEquations(H, share @ self.g, share @ self.squares, share @ self.counts)

    def faded(self, share: float) -> VelocityEquations:
        """The same as if only a `share` of it had been said."""
        return VelocityEquations(*(share * values for values in vars(self).values()))

    def over(self, variances: Float64) -> VelocityEquations:
        """The same in units in which their errors, of `variances` [n] as they are, have the variance 1."""
        share = 1 / variances
        return VelocityEquations(
            share[:, None, None] * self.H, share[:, None] * self.g, share * self.squares, self.counts
        )

    def about(self, points: Float64) -> VelocityEquations:
        """The same with the velocities of the points [n, 3] (m) as unknowns."""
        library = kernels()
        if library is None:
            return self.about_reference(points)
        H, g, at = (np.ascontiguousarray(values, np.float64) for values in (self.H, self.g, points))
        own = VelocityEquations(np.empty_like(H), np.empty_like(g), self.squares, self.counts)
        library.run(MoveRequest(len(self), *addresses_of(H, g, at, own.H, own.g)))
        return own

    def about_reference(self, points: Float64) -> VelocityEquations:
        """The same in NumPy: the reference of the compiled kernel."""
        shift = _shift(-points)
        turned = np.swapaxes(shift, 1, 2)
        return VelocityEquations(
            turned @ self.H @ shift, (turned @ self.g[..., None])[..., 0], self.squares, self.counts
        )


def stacked(*some: VelocityEquations) -> VelocityEquations:
    """Those of several groups of bodies, one group after another."""
    return VelocityEquations(*(np.concatenate([vars(one)[name] for one in some]) for name in vars(some[0])))


def nothing(count: int) -> VelocityEquations:
    """What nobody has said of `count` bodies."""
    return VelocityEquations(
        np.zeros((count, PARAMETERS, PARAMETERS)), np.zeros((count, PARAMETERS)), np.zeros(count), np.zeros(count)
    )


@dataclass(frozen=True)
class PoseEquations:
    """One set's normal equations of n bodies in corrections to their predicted poses."""

    H: Float64
    """[n, 6, 6] per (m, rad) squared."""
    g: Float64
    """[n, 6]."""
    squares: Float64
    """[n]."""
    counts: Float64
    """[n]."""
    origins: Float64
    """[n, 3] m, the predicted positions."""
    moved: Float64
    """[n, 6] m and rad, from the poses of the set before to the predicted ones."""

    def velocity_equations(self, dt_s: float) -> VelocityEquations:
        """The same in velocities over the `dt_s` since the set before."""
        Hu = (self.H @ self.moved[..., None])[..., 0]
        g = self.g + Hu
        squares = self.squares + ((self.g + g) * self.moved).sum(-1)
        own = VelocityEquations(dt_s**2 * self.H, dt_s * g, squares, self.counts / CORRELATED)
        scaled = VelocityEquations(own.H / CORRELATED, own.g / CORRELATED, own.squares / CORRELATED, own.counts)
        return scaled.about(-self.origins)


@dataclass(frozen=True)
class Judged:
    """How well n bodies explain what was said of them, each by the most likely velocity."""

    evidence: Float64
    """[n] log of the probability of the observations, nats: half the squared errors, and what the parameters cost.

    They cost half the logarithm of how much more is known of them than before, which (k / 2) log n approximates
    (Schwarz, 1978) where all k can be told from the images.
    """
    at_rest: Float64
    """[n] the same of bodies that do not move: no parameters."""
    fit: Float64
    """[n] the evidence without what the parameters cost."""
    costs: Float64
    """[n] squared errors left over."""
    told: Float64
    """[n] parameters that the observations tell, 0 to 6."""

    @property
    def best(self) -> Float64:
        """[n] evidence of what explains the observations better: moving, or resting, which is the rarer here."""
        better: Float64 = np.maximum(self.evidence, self.at_rest - RARELY)
        return better


def judge(said: VelocityEquations, points: Float64) -> Judged:
    """Judges bodies about `points` [n, 3] m, their middles, by what was said of them with errors of variance 1.

    Where what is said of one part of a body errs more than of another, each comes `over` its own: a white arm, at whose
    edges flow errs, would otherwise drown what a textured block beside it says.
    """
    library = kernels()
    if library is None:
        return judge_reference(said, points)
    given = [np.ascontiguousarray(values, np.float64) for values in (USUAL, said.H, said.g, said.squares, points)]
    judged = Judged(*np.empty((5, len(said))))
    library.run(JudgeRequest(len(said), *addresses_of(*given, *vars(judged).values())))
    return judged


def judge_reference(said: VelocityEquations, points: Float64) -> Judged:
    """The same in NumPy: the reference of the compiled kernel."""
    own = said.about_reference(points)
    known = np.eye(PARAMETERS) + USUAL[:, None] * own.H * USUAL
    root = np.linalg.inv(np.linalg.cholesky(known))
    explained = np.square(root @ (USUAL * own.g)[..., None]).sum((1, 2))
    at_rest = -own.squares / 2
    evidence = at_rest + explained / 2 + np.log(np.diagonal(root, axis1=1, axis2=2)).sum(-1)
    told = PARAMETERS - np.square(root).sum((1, 2))
    return Judged(evidence, at_rest, at_rest + explained / 2, own.squares - explained, told)


def misfits(said: VelocityEquations, points: Float64, usual: float) -> Float64:
    """[n] variance of the errors of bodies about `points` [n, 3] m, in units of what the flow claims.

    Their own, and what is `usual` among all, which has the weight of some observations: one body alone has few.
    """
    return misfits_of(said.counts, judge(said, points), usual)


def misfits_of(counts: Float64, judged: Judged, usual: float) -> Float64:
    """[n] the same of bodies of which `counts` [n] observations, as they are, have been judged."""
    free = np.maximum(counts - judged.told, 0.0)
    own = (judged.costs + SHARED_OBSERVATIONS * usual) / (free + SHARED_OBSERVATIONS)
    floored: Float64 = np.maximum(own, LEAST_MISFIT)
    return floored


def usual_misfit(counts: Float64, judged: Judged) -> float:
    """Variance of the errors of all bodies together, of which `counts` [n] observations have been judged."""
    return float(judged.costs.sum() / max(np.maximum(counts - judged.told, 0.0).sum(), 1.0))


def velocities_of(said: VelocityEquations, points: Float64) -> Float64:
    """[n, 6] the most likely velocities of bodies about `points` [n, 3] m: m/s and rad/s."""
    library = kernels()
    if library is None:
        return velocities_reference(said, points)
    given = [np.ascontiguousarray(values, np.float64) for values in (LOOSE, said.H, said.g, points)]
    velocities = np.empty((len(said), PARAMETERS))
    library.run(VelocityRequest(len(said), *addresses_of(*given, velocities)))
    return velocities


def velocities_reference(said: VelocityEquations, points: Float64) -> Float64:
    """The same in NumPy: the reference of the compiled kernel."""
    own = said.about_reference(points)
    return np.asarray(np.linalg.solve(own.H + np.diag(1 / LOOSE**2), own.g[..., None])[..., 0], np.float64)


def add_up(values: Float64, owners: NDArray[np.int64], sums: Float64) -> None:
    """Adds each of `values` [n, ...] to the one of `sums` [m, ...] that belongs to its owner, `owners` [n]."""
    library = kernels()
    if library is None:
        np.add.at(sums, owners, values)
        return
    given, whose = np.ascontiguousarray(values, np.float64), np.ascontiguousarray(owners, np.int64)
    library.run(SumRequest(len(whose), given[:1].size, *addresses_of(whose, given, sums)))


def _shift(points: Float64) -> Float64:
    """[n, 6, 6] from the velocity at a place to that [n, 3] m further on: v + w x d = v - [d] w."""
    shift = np.tile(np.eye(PARAMETERS), (len(points), 1, 1))
    x, y, z = points.T
    shift[:, 0, 4], shift[:, 0, 5], shift[:, 1, 5] = z, -y, x
    shift[:, 1, 3], shift[:, 2, 3], shift[:, 2, 4] = -z, y, -x
    return shift
