"""Whether cameras see the arm where its joints and the rig say that it is: a rig in another base, a hand-eye pose that
is far off and joints of another arm show there, and nowhere else while the twin runs."""

from __future__ import annotations

import math

import numpy as np

from twin_node.robot import ArmModel, PlacedCapsules, forward_kinematics, place_capsules
from twin_node.scene import FrameSet, JointSample, View

EVERY_NS = 200_000_000
"""Time between two looks: nothing here changes from set to set."""
STEP_M = 0.02
"""Distance of the places on the capsules' axes that are looked for."""
CLEAR_M, DEPTH_SHARE = 0.05, 0.01
"""What is measured so far past a capsule is past it, m and as a share of the depth: errors of depth and of shapes."""
FEWEST = 12
"""Places of one look that a camera must see, or see past, to tell anything."""
MEMORY_S = 1.0
"""Time in which what was seen before is forgotten: somebody may hide the arm, and joints may be late while it turns."""
PAST = 0.2
"""Share of places seen past that is too much. In the simulated cell none are with a rig that is right or 5 cm off, 5 %
at 8 cm, 20 to 60 at 12 cm, and 93 % in a base that is turned by 180 degrees."""


class ArmSight:
    """Watches one arm, whose depth cameras say where it is."""

    def __init__(self, arm: ArmModel | None) -> None:
        self._arm = arm
        self._looked: int | None = None
        self._past: dict[str, float] = {}
        """Per camera that has told anything: share of places that it sees past, averaged over time."""

    def heed(self, frames: FrameSet) -> None:
        """Takes in a set with its joints. Raises `RobotError` for joints that are not the arm's."""
        if self._arm is None or frames.joints is None:
            return
        since_ns = EVERY_NS if self._looked is None else frames.stamp - self._looked
        if since_ns < EVERY_NS:
            return
        self._looked = frames.stamp
        uptake = 1 - math.exp(-since_ns * 1e-9 / MEMORY_S)
        placed = self._placed(self._arm, frames.joints)
        for view in frames.views:
            share, name = seen_past(placed, view), view.camera.name
            if share is not None:
                before = self._past.get(name, 0.0)
                self._past[name] = before + uptake * (share - before)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader must know: a line where some camera sees past the arm."""
        wrong = [name for name, share in self._past.items() if share > PAST]
        if not wrong:
            return ()
        if len(wrong) < len(self._past):
            return (
                f"model: the arm is not where camera {', '.join(wrong)} should see it, and the others do: calibrate "
                "that camera's pose anew",
            )
        return (
            "model: the arm is not where its joints and the rig say, for cameras see past it: the rig's poses are in "
            "another frame than base_link (a UR's own base is turned by 180 degrees), the hand-eye pose is off, or "
            "the joints are another arm's or late; see calibrate check and calibrate hand-eye",
        )

    @staticmethod
    def _placed(arm: ArmModel, joints: JointSample) -> PlacedCapsules:
        return place_capsules(arm, forward_kinematics(arm, arm.ordered_positions(joints)))


def seen_past(placed: PlacedCapsules, view: View) -> float | None:
    """Share of the places on an arm's axes that a camera measures something past, of those that nothing hides from it.

    None where too few are told.
    """
    if view.depth is None:
        return None
    axes = placed.ends[:, 1] - placed.ends[:, 0]
    counts = np.maximum(np.linalg.norm(axes, axis=1) / STEP_M, 1).astype(np.int64)
    of = np.repeat(np.arange(len(axes)), counts)
    shares = (np.arange(len(of)) - np.repeat(np.cumsum(counts) - counts, counts) + 0.5) / counts[of]
    places = placed.ends[of, 0] + shares[:, None] * axes[of]
    camera, K = view.camera, view.camera.K
    x, y, z = (places @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]).T
    before = z > placed.radii[of]
    x, y, z, radii = x[before], y[before], z[before], placed.radii[of][before]
    columns = np.floor(x / z * K[0, 0] + K[0, 2])
    rows = np.floor(y / z * K[1, 1] + K[1, 2])
    inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
    depth = view.depth[rows[inside].astype(np.int64), columns[inside].astype(np.int64)]
    beyond = depth - z[inside]
    limit = radii[inside] + CLEAR_M + DEPTH_SHARE * z[inside]
    told = (depth > 0) & (beyond > -limit)
    return float((beyond > limit)[told].mean()) if told.sum() >= FEWEST else None
