"""What is decided about nodes, and what spoke for it."""

from __future__ import annotations

from dataclasses import dataclass
from enum import Enum


@dataclass(frozen=True)
class LogEvidence:
    """What speaks for a decision, as logarithms of probabilities, nats."""

    one: float
    """Evidence that there is one body."""
    two: float
    """Evidence that there are two; minus infinity where that was not asked."""
    at_rest: float
    """Evidence that nothing moves."""
    misfit: float
    """Variance of the errors in units of what the flow claims."""


@dataclass(frozen=True)
class ChangedView:
    """What of a thing at rest looks otherwise than it did."""

    visible: int
    """Gaussians of it that some view shows."""
    stirred: int
    """Those of them where a view shows something else."""


@dataclass(frozen=True)
class BornBeside:
    """What is born of the kind of a thing at rest, next to it."""

    births: int
    """Gaussians."""


@dataclass(frozen=True)
class BendEvidence:
    """What speaks for a strain beside a node's rigid motion; sums of squared errors are in units of their variance."""

    rigid: float
    """What the rigid motion leaves of the set that decided."""
    strained: float
    """What is left with a strain added."""
    count: float
    """Independent observations of that set."""
    gain: float
    """Nats by which the strain explains that set better, less the cost of its parameters."""
    evidence: float
    """Nats of all sets, older ones faded, against `PROMOTE` and `DEMOTE`."""


class Kind(Enum):
    """What has been decided about nodes."""

    MERGED = "merged"
    SPLIT = "split"
    PASSED = "passed"
    """Part of a node has gone over to another."""
    SETTLED = "settled"
    WOKEN = "woken"
    BENDS = "bends"
    """DEFORMABLE now, with all that it carries."""
    STIFFENED = "stiffened"
    """RIGID again."""


@dataclass(frozen=True)
class Decision:
    """One decision and what spoke for it."""

    kind: Kind
    stamp: int
    """ns."""
    node: int
    """Id of the node that goes on, loses a part, has come to rest, or had come to rest."""
    other: int
    """Id of the node that has ended, begun, or gained the part; `node` itself where it settles, bends or stiffens."""
    grounds: LogEvidence | ChangedView | BornBeside | BendEvidence
