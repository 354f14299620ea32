"""What an arm carries for good, as capsules that go with its last link."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_node.arm.errors import ArmError
from twin_node.robot import ArmModel

FARTHEST_TOOL_M = 2.0
"""No part of a tool is farther from `tool0`, m: who gives more means millimetres."""


@dataclass(frozen=True)
class ToolCapsule:
    """A capsule about a part of what the arm carries for good, in the frame of `tool0`; equal ends make a sphere."""

    start: tuple[float, float, float]
    """m."""
    end: tuple[float, float, float]
    """m."""
    radius: float
    """m."""

    def __post_init__(self) -> None:
        """Raises `ArmError` for values that make no capsule, or one in millimetres."""
        places = np.abs([*self.start, *self.end])
        if not (places <= FARTHEST_TOOL_M).all() or not 0 < self.radius <= FARTHEST_TOOL_M:
            raise ArmError(
                f"tool: expected ends and a radius in metres, at most {FARTHEST_TOOL_M:g} from tool0, found "
                f"{list(self.start)}, {list(self.end)} and {self.radius:g}"
            )


def with_tool(model: ArmModel, tool: Sequence[ToolCapsule]) -> ArmModel:
    """The arm with the tool on its last link; without one, the same."""
    if not tool:
        return model
    ends = np.array([[capsule.start, capsule.end] for capsule in tool])
    return model.carrying(ends, np.array([capsule.radius for capsule in tool]))
