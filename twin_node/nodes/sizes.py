"""The live model from tiny to full: the same algorithm with less or more of what costs time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from enum import Enum

from twin_node.model import ModelParameters
from twin_node.nodes.log_source import DEFAULT_WIDTH
from twin_node.ranges import POSITIVE, check_ranges
from twin_node.runtime.parameters import ParameterError


@dataclass(frozen=True)
class Size:
    """What the live model may spend on a set."""

    width: int
    """Working width of the images, px; wider ones are made smaller, narrower ones stay."""
    gaussians_per_pixel: float
    most_gaussians: int
    steps: int
    """Gradient steps per set on what moves."""
    births: int
    """Gaussians born per set at most."""
    moving_share: float
    """Share of the Gaussians that may move: the fewer there are in all, the larger.

    With the share of `large`, `small` has two decibels less of what moves.
    """

    def model(self, base: ModelParameters) -> ModelParameters:
        """The parameters of a model of this size; what a size does not say stays as it is in `base`."""
        return replace(
            base,
            gaussians_per_pixel=self.gaussians_per_pixel,
            most_gaussians=self.most_gaussians,
            track=replace(base.track, steps=self.steps),
            birth=replace(base.birth, per_set=self.births, moving_share=self.moving_share),
        )


_DEFAULT = ModelParameters()

SIZES: Mapping[str, Size] = {
    "tiny": Size(64, 0.1, 2_000, 1, 40, 0.15),
    "small": Size(96, 0.2, 6_000, 2, 80, 0.15),
    "medium": Size(128, 0.3, 12_000, 3, 140, 0.09),
    "large": Size(
        DEFAULT_WIDTH,
        _DEFAULT.gaussians_per_pixel,
        _DEFAULT.most_gaussians,
        _DEFAULT.track.steps,
        _DEFAULT.birth.per_set,
        _DEFAULT.birth.moving_share,
    ),
    "full": Size(240, 0.5, 48_000, 12, 400, _DEFAULT.birth.moving_share),
}
"""`large` is what ships; `launch/sizes.yaml` tells what each takes and reaches."""
SHIPPED = "large"


class SizeChoice(Enum):
    """How the size is found."""

    GIVEN = "given"
    """As the sections `model` and `synchronizer` say."""
    AUTO = "auto"
    """Measured by a launched twin on its first sets; given where nothing is launched, as in a replay."""
    TINY = "tiny"
    SMALL = "small"
    MEDIUM = "medium"
    LARGE = "large"
    FULL = "full"


@dataclass(frozen=True)
class SizeParameters:
    """Which size the twin has."""

    name: SizeChoice = SizeChoice.GIVEN
    budget_ms: float = 40.0
    """What model and forecast may take of a set with people at work, where the size is measured, ms of their thread's
    processor time. Beside arm, driver and viewer on two cores obstacles are three to four times as old when the arm
    hears of them, and what an arm may do beside people falls to a third from 60 to 100 ms."""

    def __post_init__(self) -> None:
        """Raises `ParameterError` for a budget that nothing keeps."""
        check_ranges(self, ParameterError, "size: ", budget_ms=POSITIVE)
