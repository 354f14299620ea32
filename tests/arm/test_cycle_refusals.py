"""Cycles that no arm can do are refused; they came out as other ones."""

from __future__ import annotations

import numpy as np
import pytest

from twin_node.arm import ArmError, CycleParameters, CyclicPath, default_path
from twin_node.robot import ur_model
from twin_node.scene import JointPath

NAMES = ur_model("ur5e").joint_names


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("speed", 0.0),
        ("speed", -1.0),
        ("speed", np.nan),
        ("acceleration", 0.0),
        ("acceleration", -1.4),
        ("dwell_s", np.nan),
        ("dwell_s", -0.4),
        ("lift_m", np.nan),
        ("lift_m", -0.15),
        ("tool_length_m", np.inf),
    ],
)
def test_a_cycle_that_does_not_move_as_asked_is_refused(field: str, value: float) -> None:
    """At a speed of 0 it jumped from stop to stop, at one below it took its acceleration's time."""
    with pytest.raises(ArmError, match=f"cycle: {field}: expected .*, found {value:g}"):
        default_path(ur_model("ur5e"), parameters=CycleParameters(**{field: value}))


def test_a_workspace_without_end_is_refused() -> None:
    with pytest.raises(ArmError, match="workspace: expected a lower and an upper corner"):
        default_path(ur_model("ur5e"), np.array([[0.0, -0.4, 0.0], [np.inf, 0.4, 0.5]]))


@pytest.mark.parametrize("stamps", [[0], [100, 200], []], ids=["one pose", "late", "none"])
def test_a_template_without_a_period_from_0_on_is_refused(stamps: list[int]) -> None:
    """One that begins later was gone through from its end on, and of one pose no period could be made."""
    with pytest.raises(ArmError, match=f"cycle: expected a template .* found stamps {stamps[:1]}".replace("[", r"\[")):
        CyclicPath(JointPath(NAMES, np.array(stamps, np.int64), np.zeros((len(stamps), 6))))
