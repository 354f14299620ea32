"""What errors are expected of nodes: a regression of their logarithm on cues, fitted online to the upper part of them.

Asymmetric least squares (Newey and Powell 1987), with forgetting.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from twin_node.forecast.kernels import kernels
from twin_node.forecast.part_requests import RegressRequest
from twin_node.native_library import addresses_of
from twin_node.scene import Float64


@dataclass(frozen=True)
class Scale:
    """The regression of the logarithm of errors on their cues; `regress` changes it."""

    gram: Float64
    """[C, C] of its normal equations."""
    moment: Float64
    """[C] their right sides."""
    slopes: Float64
    """[C] what they say."""

    @classmethod
    def before_errors(cls) -> Scale:
        """With what is supposed of it."""
        gram = np.eye(len(PRIOR_SLOPES)) * _PRIOR
        return cls(gram, gram @ PRIOR_SLOPES, PRIOR_SLOPES.copy())


@dataclass(frozen=True)
class Came:
    """How n errors came out."""

    then: Float64
    """[n, C] of the nodes when forecast."""
    logs: Float64
    """[n] their logarithms."""
    kept: float
    """Share of what was learnt before that is kept."""
    weight: float
    """Of each of them, between those above and those below what was expected."""


def regress(scale: Scale, came: Came) -> None:
    """Learns from errors. Compiled; `regress_reference` where that cannot be, the same but for rounding."""
    compiled = kernels()
    if compiled is None:
        regress_reference(scale, came)
        return
    given = (np.ascontiguousarray(came.then), np.ascontiguousarray(came.logs), PRIOR_SLOPES)
    lengths = (came.kept, came.weight, _UPPER, _RIDGE)
    addresses = addresses_of(*given, scale.gram, scale.moment, scale.slopes)
    compiled.run(RegressRequest(len(came.logs), len(PRIOR_SLOPES), *lengths, *addresses))


def regress_reference(scale: Scale, came: Came) -> None:
    """What `regress` does."""
    then, ridge = came.then, np.eye(len(PRIOR_SLOPES)) * _RIDGE
    above = came.logs > then @ scale.slopes
    weights = np.where(above, _UPPER, 1 - _UPPER) * came.weight
    scale.gram[:] = came.kept * scale.gram + (then.T * weights) @ then
    scale.moment[:] = came.kept * scale.moment + then.T @ (weights * came.logs)
    scale.slopes[:] = np.linalg.solve(scale.gram + ridge, scale.moment + ridge @ PRIOR_SLOPES)


_SLOPES = (0.2, 0.3, 0.1, 0.15, 0.1, 0.15)
"""Share of each cue in the scale before errors tell, in the order of `CueLengths`: what goes far errs most."""
PRIOR_SLOPES = np.append(0.0, _SLOPES)
"""The same of all cues."""
_PRIOR = 0.5
"""Weight of the prior slopes in samples: the scale is proportional to the cues until errors say otherwise."""
_RIDGE = 0.1
"""The part of that prior that is never forgotten."""
_UPPER = 0.9
"""Weight of errors above expectation against those below: large errors make the bound."""
