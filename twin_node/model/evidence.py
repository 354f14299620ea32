"""When a node needs a richer motion model: likelihood gained, less what the extra parameters cost (Schwarz, 1978)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from twin_node.model.velocity_equations import CORRELATED

LEAST = 1e-9
"""Keeps ratios of squares finite."""
FORGETTING = 0.9
"""Share of the evidence that a set keeps: things change how they move within ten sets."""
PROMOTE, DEMOTE = 20.0, -20.0
"""Evidence (nats) at which a node becomes DEFORMABLE and RIGID again; apart, so that it does not flicker."""
TOLERATED = 0.3
"""Share of the errors that a strain takes away where nothing bends: links of one jointed arm, light that is uneven."""
EXTRA_PARAMETERS = 6
"""Of a symmetric strain, the simplest motion that no rigid one explains."""


@dataclass(frozen=True)
class Fits:
    """How well two motion models explain one set, per node."""

    rigid: Tensor
    """[M] sum of squared errors of the rigid motion, in units of their variance."""
    strained: Tensor
    """[M] the same with a strain added."""
    count: Tensor
    """[M] independent observations."""


def gain(fits: Fits) -> Tensor:
    """[M] nats by which the strain explains a set better, less (k / 2) log n for its k parameters.

    How much the flow errs is not known beforehand: the likelihood is that of errors whose variance is what each model
    leaves, so that a large body is not called bending because flow errs more than it claims.
    """
    rigid, strained, observed = (of.numpy() for of in (fits.rigid, fits.strained, fits.count))  # few: faster than torch
    count = observed / CORRELATED
    cost = EXTRA_PARAMETERS / 2 * np.log(np.maximum(count, 2.0))
    ratio = np.maximum(rigid, LEAST) / np.maximum(strained, LEAST)
    gained = count / 2 * np.log((1 - TOLERATED) * ratio) - cost
    return torch.from_numpy(np.where(count > EXTRA_PARAMETERS, gained, 0.0))


def accumulate(evidence: Tensor, fits: Fits) -> Tensor:
    """[M] evidence after another set, bounded so that a long calm does not have to be paid back."""
    return (FORGETTING * evidence + gain(fits)).clamp(2 * DEMOTE, 2 * PROMOTE)
