"""Whether an arm works where somebody looks."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from twin_node.robot import ArmModel, forward_kinematics, place_capsules
from twin_node.scene import Float64


def beyond(model: ArmModel, q: NDArray[np.floating], workspace: Float64) -> float:
    """How far (m) an arm's last link, with all that it carries, sticks out of a workspace [2, 3] (corners, m).

    Zero or negative inside, minus infinity where the last link has no capsules. Below the workspace is its floor, which
    a tool touches, and outside of it may be the links before, as those of an arm beside the workspace are. `q` [J] rad;
    raises `RobotError` for angles that are not usable.
    """
    placed = place_capsules(model, forward_kinematics(model, q))
    last = placed.links == model.joints
    ends, radii = placed.ends[last], placed.radii[last][:, None, None]
    sides = (workspace[0] - (ends - radii))[..., :2]
    return float(max(sides.max(initial=-np.inf), (ends + radii - workspace[1]).max(initial=-np.inf)))
