"""What all views together say of the velocities of parts: least squares with Cauchy's loss, by reweighting."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast import kernels, part_requests
from twin_node.forecast.measured import UNKNOWN_SPEED
from twin_node.forecast.things import Whole
from twin_node.native_library import addresses_of
from twin_node.scene import Bool, Float64


@dataclass(frozen=True)
class Sighting:
    """What one view says of the motion of M parts since its last image."""

    elapsed_s: float
    jacobian: Float64
    """[M, 2, 3] pixels per metre."""
    shifts: Float64
    """[M, 2] pixels moved."""
    variances: Float64
    """[M] pixels^2; infinite for parts that it does not show, or did not show before."""
    shown: Bool
    """[M]."""
    axis: Float64
    """[3] the optical axis in the base frame."""
    receded: Float64
    """[M] m by which they went away from the camera; 0 where that is not known."""
    depths: Float64
    """[M] m; infinite for parts whose depth was not measured both times."""

    @property
    def depth_trusts(self) -> Float64:
        """[M] s^2/m^2, the inverse of the variance of the velocities along the axis; 0 where it was not measured."""
        sigma: Float64 = _DEPTH_SIGMA + _DEPTH_SHARE * self.depths
        return self.elapsed_s**2 / sigma**2

    def has_lost(self, velocities: Float64) -> bool:
        """Whether some part went further, at velocities [M, 3], than flow finds it, and another way than it says."""
        gone = np.einsum("mki,mi->mk", self.jacobian, velocities) * self.elapsed_s
        far = np.linalg.norm(gone, axis=1)
        off = np.linalg.norm(gone - self.shifts, axis=1)
        astray = np.isinf(self.variances) | (off > _ASTRAY * far)
        return bool(((far > FOUND_PIXELS) & astray & self.shown).any())


@dataclass(frozen=True)
class Estimate:
    """Velocities of M parts."""

    velocities: Float64
    """[M, 3] m/s."""
    sigmas: Float64
    """[M] standard deviation of each component, m/s, at most `UNKNOWN_SPEED`."""

    @classmethod
    def unknown(cls, count: int) -> Estimate:
        """Of `count` parts of which nothing is known."""
        return cls(np.zeros((count, 3)), np.full(count, UNKNOWN_SPEED))

    def after(self, elapsed_s: float) -> Estimate:
        """What is known of it some time later."""
        sigmas = np.hypot(self.sigmas, _ACCELERATION * elapsed_s)
        return Estimate(self.velocities, np.minimum(sigmas, UNKNOWN_SPEED))

    def of(self, rows: NDArray[np.int64]) -> Estimate:
        """How the parts in `rows` move; nothing is known of those of the row after the last."""
        none = Estimate.unknown(1)
        return Estimate(
            np.append(self.velocities, none.velocities, axis=0)[rows], np.append(self.sigmas, none.sigmas)[rows]
        )


class Agreement(NamedTuple):
    """What V views, and what was known before, say of the motion of parts."""

    motion: Estimate
    lost: Bool
    """[V] views whose flow has not found some part that they show: it went too far, and another way than they say."""


def agreed(sightings: Sequence[Sighting], expected: Estimate, whole: Whole) -> Agreement:
    """What the sightings, the wholes and what is expected agree on best.

    What falls goes as all of it went: what images show of it spins, and is further on than flow looks. Compiled;
    `agreed_reference` where that cannot be, the same but for rounding.
    """
    compiled = kernels.kernels()
    if compiled is None:
        return agreed_reference(sightings, expected, whole)
    given = (part_requests.SolveView * len(sightings))()
    held = [_arrays(one) for one in sightings]  # alive until the call is over
    for row, (one, arrays) in enumerate(zip(sightings, held, strict=True)):
        given[row] = part_requests.SolveView(*addresses_of(*arrays), one.elapsed_s, tuple(one.axis.tolist()))
    told = (expected.velocities, expected.sigmas, whole.velocities, whole.sigmas)
    known = (*(np.ascontiguousarray(array, np.float64) for array in told), np.ascontiguousarray(whole.falling))
    found = Estimate(np.empty((len(expected.sigmas), 3)), np.empty(len(expected.sigmas)))
    lost = np.empty(len(sightings), np.bool_)
    sizes = (len(expected.sigmas), len(sightings), _TURNS)
    limits = (UNKNOWN_SPEED, _DEPTH_SIGMA, _DEPTH_SHARE, FOUND_PIXELS, _ASTRAY)
    addresses = addresses_of(*known, found.velocities, found.sigmas, lost)
    compiled.run(part_requests.SolveRequest(*sizes, *limits, ctypes.addressof(given), *addresses))
    return Agreement(found, lost)


def _arrays(one: Sighting) -> tuple[NDArray[Any], ...]:
    """In the order of `part_requests.SolveView`."""
    given = (one.jacobian, one.shifts, one.variances, one.receded, one.depths)
    return (*(np.ascontiguousarray(array, np.float64) for array in given), np.ascontiguousarray(one.shown))


def agreed_reference(sightings: Sequence[Sighting], expected: Estimate, whole: Whole) -> Agreement:
    """What `agreed` does."""
    found, falling = _solved_reference(sightings, expected, whole), whole.falling
    velocities = np.where(falling[:, None], whole.velocities, found.velocities)
    sigmas = np.where(falling, np.minimum(whole.sigmas, UNKNOWN_SPEED), found.sigmas)
    lost = [one.has_lost(velocities) for one in sightings]
    return Agreement(Estimate(velocities, sigmas), np.array(lost, np.bool_))


def _solved_reference(sightings: Sequence[Sighting], expected: Estimate, whole: Whole) -> Estimate:
    """The same of what does not fall."""
    prior = expected.velocities
    designs = [sighting.jacobian * sighting.elapsed_s for sighting in sightings]
    velocities = prior
    for turn in range(_TURNS):
        own = 1 / (expected.sigmas**2 + ((velocities - prior) ** 2).sum(axis=1))
        seen = whole.trusts / (1 + whole.trusts * ((velocities - whole.velocities) ** 2).sum(axis=1) * (turn > 0))
        normal = (own + seen)[:, None, None] * np.eye(3)
        right = own[:, None] * prior + seen[:, None] * whole.velocities
        for one, design in zip(sightings, designs, strict=True):
            trust, depth_trust = 1 / one.variances, one.depth_trusts
            misfit = np.einsum("mki,mi->mk", design, velocities) - one.shifts
            doubted = trust / (1 + trust * (misfit**2).sum(axis=1)) if turn else trust
            scaled = design * doubted[:, None, None]
            normal += np.einsum("mki,mkj->mij", scaled, design)
            right += np.einsum("mki,mk->mi", scaled, one.shifts)
            away = velocities @ one.axis - one.receded / one.elapsed_s
            doubted = depth_trust / (1 + depth_trust * away**2) if turn else depth_trust
            normal += doubted[:, None, None] * np.outer(one.axis, one.axis)
            right += (doubted * one.receded / one.elapsed_s)[:, None] * one.axis
        inverse = np.linalg.inv(normal)
        velocities = (inverse @ right[..., None])[..., 0]
    sigmas = np.minimum(np.sqrt(np.einsum("mii->m", inverse) / 3), UNKNOWN_SPEED)
    return Estimate(velocities, sigmas)


_DEPTH_SIGMA, _DEPTH_SHARE = 0.02, 0.02
"""Error of the change of a part's depth, m and as a share of the depth."""
FOUND_PIXELS, _ASTRAY = 5.0, 0.35
"""Flow finds what has gone less than the first, pixels; what has gone further it has not found if it is off by more
than the second, as a share of the way."""
_TURNS = 4
"""Rounds of reweighting."""
_ACCELERATION = 5.0
"""By which velocities change, m/s^2."""
