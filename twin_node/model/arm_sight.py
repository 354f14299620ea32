"""Whether cameras see the arm where its joints and the rig say that it is: another arm, a rig in another base, a
hand-eye pose that is far off and joints in another order show there, and nowhere else while the twin runs."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from twin_node.geometry import pose, rotation_from_quat
from twin_node.robot import (
    UR_NAMES,
    ArmModel,
    PlacedCapsules,
    forward_kinematics,
    place_capsules,
    ur_model,
    ur_shape,
)
from twin_node.scene import Float64, FrameSet, View

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
FITS = 0.05
"""Share at which another arm, or another base, is where this one should be."""
TURNS_DEG = (180, 90, -90)
"""By which one base is turned against another: a UR's own against `base_link`, and who mounts it as he stands."""


class ArmSight:
    """Watches one arm, whose depth cameras say where it is."""

    def __init__(self, arm: ArmModel | None) -> None:
        self._arm = arm
        self._looked: int | None = None
        self._past: dict[str, float] = {}
        """Per camera that tells anything, or did lately: share of places that it sees past, averaged over time."""
        self._cause = ""
        """What would explain it, as far as that has been found."""

    def heed(self, frames: FrameSet) -> None:
        """Takes in a set; without joints no camera tells anything. Raises `RobotError` for joints of another arm."""
        if self._arm is None:
            return
        since_ns = EVERY_NS if self._looked is None else frames.stamp - self._looked
        if since_ns < EVERY_NS:
            return
        self._looked = frames.stamp
        q = None if frames.joints is None else self._arm.ordered_positions(frames.joints.at(frames.stamp))
        uptake = 1 - math.exp(-since_ns * 1e-9 / MEMORY_S)
        shares = {} if q is None else _shares(self._arm, q, frames.views)
        names = dict.fromkeys((*self._past, *shares))
        past = {name: (1 - uptake) * self._past.get(name, 0.0) + uptake * shares.get(name, 0.0) for name in names}
        self._past = {name: share for name, share in past.items() if name in shares or share > FITS}
        if not self._wrong:
            self._cause = ""
        elif not self._cause and q is not None and shares:
            self._cause = next(self._explanations(q, frames.views, len(shares)), "")

    @property
    def _wrong(self) -> list[str]:
        """Cameras that see past the arm."""
        return [name for name, share in self._past.items() if share > PAST]

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader must know: a line where some camera sees past the arm."""
        wrong = self._wrong
        if self._arm is None or not wrong:
            return ()
        if len(wrong) < len(self._past) and not self._cause:
            return (
                f"model: the arm is not where camera {', '.join(wrong)} should see it, and the others do: calibrate "
                "that camera's pose anew",
            )
        cause = self._cause or (
            f"it is no {self._arm.name}, its joints are late or in another order, the hand-eye pose is off, or the "
            "rig's poses are in another frame than base_link; see calibrate check and calibrate hand-eye"
        )
        return (f"model: the arm is not where its joints and the rig say, for cameras see past it: {cause}",)

    def _explanations(self, q: Float64, views: Sequence[View], cameras: int) -> Iterator[str]:
        """Other arms and bases with which cameras would see the arm, as many as tell of it now."""
        assert self._arm is not None

        def fits(arm: ArmModel, seen: Sequence[View]) -> bool:
            shares = _shares(arm, q, seen).values()
            return len(shares) >= cameras and max(shares, default=1.0) < FITS

        own = ur_shape(self._arm.name) if self._arm.name in UR_NAMES else None
        for name in dict.fromkeys(map(ur_shape, UR_NAMES)) if own else ():
            if name != own and fits(ur_model(name), views):
                yield f"it looks like a {name} and not like a {self._arm.name}; set `model` of the arm"
        for degrees in TURNS_DEG:
            half = math.radians(degrees) / 2
            turn = pose(rotation_from_quat(np.array([math.cos(half), 0, 0, math.sin(half)])), np.zeros(3))
            turned = [
                replace(view, camera=replace(view.camera, T_base_cam=turn @ view.camera.T_base_cam)) for view in views
            ]
            if fits(self._arm, turned):
                yield (
                    f"the rig's poses are in a frame that is turned by {degrees} degrees about z against base_link"
                    f"{', as that of a UR controller is' if degrees == TURNS_DEG[0] else ''}; turn them by as much"
                )


def _shares(arm: ArmModel, q: Float64, views: Sequence[View]) -> dict[str, float]:
    """`seen_past` of each camera that tells."""
    placed = place_capsules(arm, forward_kinematics(arm, q))
    found = {view.camera.name: seen_past(placed, view) for view in views}
    return {name: share for name, share in found.items() if share is not None}


def seen_past(placed: PlacedCapsules, view: View) -> float | None:
    """Share of the places on an arm's axes that a camera measures something past, of those that nothing hides from it.

    None where too few are told. The last link's do not count: a gripper is given at its widest, with what it may hold.
    """
    if view.depth is None:
        return None
    own = placed.links < placed.links.max()
    ends, of_capsules = placed.ends[own], placed.radii[own]
    axes = ends[:, 1] - ends[:, 0]
    counts = np.maximum(np.linalg.norm(axes, axis=1) / STEP_M, 1).astype(np.int64)
    of = np.repeat(np.arange(len(axes)), counts)
    shares = (np.arange(len(of)) - np.repeat(np.cumsum(counts) - counts, counts) + 0.5) / counts[of]
    places = ends[of, 0] + shares[:, None] * axes[of]
    camera, K = view.camera, view.camera.K
    x, y, z = (places @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]).T
    before = z > of_capsules[of]
    x, y, z, radii = x[before], y[before], z[before], of_capsules[of][before]
    columns = np.floor(x / z * K[0, 0] + K[0, 2])
    rows = np.floor(y / z * K[1, 1] + K[1, 2])
    inside = (columns >= 0) & (columns < camera.width) & (rows >= 0) & (rows < camera.height)
    depth = view.depth[rows[inside].astype(np.int64), columns[inside].astype(np.int64)]
    beyond = depth - z[inside]
    limit = radii[inside] + CLEAR_M + DEPTH_SHARE * z[inside]
    told = (depth > 0) & (beyond > -limit)
    return float((beyond > limit)[told].mean()) if told.sum() >= FEWEST else None
