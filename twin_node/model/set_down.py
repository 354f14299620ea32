"""What an arm leaves where its tool has rested: a part that it has put down, ground from which it has picked one up."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from functools import partial

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import transform
from twin_node.model.camera_mask import CameraMask
from twin_node.model.capsules import nearest_capsules
from twin_node.model.ground_depth import GroundDepth
from twin_node.model.long_rest import hands
from twin_node.model.rays import points_at
from twin_node.robot import ArmModel, forward_kinematics, place_capsules
from twin_node.scene import Bool, Camera, Float32, Float64, FrameSet, View

STILL_M = 0.003
"""A tool that moves no farther than this rests, m."""
RESTS_NS = 100_000_000
"""For so long it must, to grip something or let it go, ns: a gripper takes four times as long."""
MARGIN_M, DEPTH_SHARE = 0.015, 0.005
"""What is measured so far outside a tool may be inside it, m and as a share of the depth: calibration and noise."""
BLIND_NS = 500_000_000
"""A pixel that is bared and measures nothing for so long tells nothing of what was left there, ns."""
SHADED_NS = 1_000_000_000
"""For so long after a pixel was bared the arm that leaves may shade it, ns: the same depth is then the same thing."""
LATEST_NS = 20_000_000_000
"""What is bared so long after the tool has gone may have come since, ns."""
LEAST = 0.5
"""Share of a thing's pixels that the arm must have left, or that lie beside such: the others are its rims."""
BESET_M = 0.15
"""What moves so near to where the tool rested may be somebody who hands a part over, or takes it, m."""
MOST_PLACES = 8
"""Rests of which something may still be hidden; of more the oldest are forgotten."""
_AROUND = np.ones((3, 3), np.uint8)
NEVER = np.iinfo(np.int64).max // 2
"""Has not been yet, ns."""


Pixels = NDArray[np.intp]
"""[n] rows, or columns, of pixels."""
IsLeft = Callable[[Pixels, Pixels, Float32], Bool]
"""[n] of rows and columns, and of the depth of the ground that was known there, m."""


class SetDown:
    """Watches one arm's tool: where it rested, and what the cameras see there when it has gone.

    A tool takes up its own space, and so does what it holds: what is measured in that space when the arm bares it was
    there with the tool, and is nobody who has come since.
    """

    def __init__(self, arm: ArmModel | None) -> None:
        """`arm`: with the tool that it carries (`ArmModel.carrying`); None: nothing is known of any."""
        self._arm = arm
        self._anchor: Float64 | None = None
        """[c, 2, 3] m, the axes of the tool's capsules where it stood last."""
        self._since = 0
        self._rests = False
        self._places: list[_Place] = []

    def heed(self, frames: FrameSet) -> None:
        """Takes in where the tool is at a set's stamp; sets come in rising order. Raises `RobotError` for joints of
        another arm."""
        if self._arm is None or frames.joints is None:
            self._anchor, self._rests = None, False
            return
        q = self._arm.ordered_positions(frames.joints.at(frames.stamp))
        placed = place_capsules(self._arm, forward_kinematics(self._arm, q))
        own = placed.links == self._arm.joints
        ends = placed.ends[own]
        if self._anchor is None or np.abs(ends - self._anchor).max(initial=0) > STILL_M:
            self._anchor, self._since, self._rests = ends, frames.stamp, False
        elif not self._rests and len(ends) and frames.stamp - self._since >= RESTS_NS:
            self._rests = True
            self._places.append(_Place(self._anchor, placed.radii[own], frames.stamp))
        recent = self._places[-MOST_PLACES:]
        self._places = [place for place in recent if place is recent[-1] or place.may_tell(frames.stamp)]

    def left(self, view: View, robot: Bool, camera: CameraMask) -> Bool | None:
        """[H, W] what a view shows of what the tool has left where it rested; None where there can be nothing.

        `robot`: [H, W] the arm in it; `camera`: what is known of the camera before this view. Called once per view
        after `heed`.
        """
        if not self._places:
            return None
        gone = self._places[:-1] if self._rests else self._places
        if self._rests:
            self._places[-1].hide(view, robot, camera.ground_depth)
        found = np.zeros_like(robot)
        for place in gone:
            place.bare(view, robot, camera.depth, found)
        return found if found.any() else None

    def things(self, views: Sequence[View], masks: Sequence[Bool], left: Sequence[Bool | None]) -> list[Bool | None]:
        """Per view [H, W] what of its mask the arm has put down or bared; None: nothing. `left`: as found by `left`.

        While any view shows something as wide as a hand to move near by, all may be that hand's.
        """
        found = [_things(*of) for of in zip(views, masks, left, strict=True)]
        if all(things is None for things in found):
            return found
        for view, mask, things in zip(views, masks, found, strict=True):
            if view.depth is None:
                continue
            moving = mask if things is None else mask & ~things
            rows, columns = np.nonzero(hands(moving, view.depth, view.camera.K[0, 0]) & (view.depth > 0))
            points = points_at(view.camera, rows, columns, view.depth[rows, columns].astype(np.float64))
            if any(place.is_near(points) for place in self._places):
                return [None] * len(found)
        return found


def _things(view: View, mask: Bool, left: Bool | None) -> Bool | None:
    """[H, W] the connected regions of a view's mask of which the arm has `left` most, and in whose rest no hand fits;
    None: none."""
    if left is None or view.depth is None or not (mask & left).any():
        return None
    count, labels = cv2.connectedComponents(mask.astype(np.uint8))
    with_rims = cv2.dilate(left.astype(np.uint8), _AROUND) > 0
    sizes, of_arm = (np.bincount(labels[of], minlength=count) for of in (mask, mask & with_rims))
    stands = of_arm >= LEAST * sizes
    stands[labels[hands(mask & ~with_rims, view.depth, view.camera.K[0, 0])]] = False
    stands[0] = False
    return stands[labels] if stands.any() else None


def around(camera: Camera, ends: Float64, radii: Float64) -> tuple[slice, slice]:
    """Rows and columns that may show capsules, axes between `ends` [c, 2, 3] m and `radii` [c] m, grown by the margins;
    all where one comes close to the camera."""
    middles = transform(camera.viewmat, ends.reshape(-1, 3))
    reach = np.repeat(radii, 2) + MARGIN_M + DEPTH_SHARE * middles[:, 2]
    nearest = middles[:, 2] - reach
    if len(middles) == 0 or (nearest <= reach).any():
        return slice(0, camera.height), slice(0, camera.width)
    uv = middles @ camera.K.T
    spread = np.diag(camera.K)[:2] * (reach / nearest * np.linalg.norm(middles / middles[:, 2:], axis=1))[:, None]
    pixels = uv[:, :2] / uv[:, 2:]
    size = np.array([camera.width, camera.height])
    begin = np.clip(np.floor((pixels - spread).min(axis=0)), 0, size - 1).astype(int)
    end = np.clip(np.ceil((pixels + spread).max(axis=0)) + 1, begin + 1, size).astype(int)
    return slice(int(begin[1]), int(end[1])), slice(int(begin[0]), int(end[0]))


@dataclass
class _Place:
    """Where the tool rested."""

    ends: Float64
    """[c, 2, 3] m, of the axes of its capsules."""
    radii: Float64
    """[c] m."""
    rested_at: int
    """When it did last, ns."""
    _hidden: dict[str, _Hidden] = field(default_factory=dict)
    """By camera."""

    def may_tell(self, stamp: int) -> bool:
        """Whether any camera may yet see what was left there: of what is bared late nobody knows when it came."""
        is_late = stamp - self.rested_at > LATEST_NS
        return not is_late and any(hidden.is_watched for hidden in self._hidden.values())

    def hide(self, view: View, robot: Bool, ground: Float32) -> None:
        """While the tool rests a view shows the arm at `robot` [H, W], and `ground` [H, W] (m) is what was there."""
        self.rested_at, name = view.stamp, view.camera.name
        if name not in self._hidden or self._hidden[name].shape != robot.shape:
            self._hidden[name] = _Hidden(robot.shape, around(view.camera, self.ends, self.radii))
        self._hidden[name].hide(robot, ground)

    def bare(self, view: View, robot: Bool, ground: GroundDepth, found: Bool) -> None:
        """Adds to `found` [H, W] what a view shows in the tool's space of then, or behind `ground` that was there,
        where the arm hid it until of late; that is at `robot` now."""
        hidden = self._hidden.get(view.camera.name)
        if hidden is not None and hidden.shape == robot.shape and view.depth is not None and hidden.is_watched:
            seen = ~robot if view.valid is None else view.valid & ~robot
            hidden.bare(view, seen, partial(self._is_left, view, ground), ground, found)

    def is_near(self, points: Float64) -> bool:
        """Whether any of the points [3, n] (m) is at the place."""
        return bool((nearest_capsules(self.ends, self.radii, points).gaps < BESET_M).any())

    def _is_left(self, view: View, ground: GroundDepth, rows: Pixels, columns: Pixels, known: Float32) -> Bool:
        """[n] which pixels show what was in the tool, or are bared since the tool has taken what was before them: by
        what was `known` [n] of the ground there, m."""
        assert view.depth is not None
        depth = view.depth[rows, columns].astype(np.float64)
        taken = (known > 0) & (depth > known + ground.slack(known))
        taken &= self._holds(view.camera, rows, columns, known.astype(np.float64))
        return taken | self._holds(view.camera, rows, columns, depth)

    def _holds(self, camera: Camera, rows: Pixels, columns: Pixels, depth: Float64) -> Bool:
        """[n] which pixels show what is in the tool's space of then, by their depth [n] (m)."""
        gaps = nearest_capsules(self.ends, self.radii, points_at(camera, rows, columns, depth)).gaps
        inside: Bool = gaps <= MARGIN_M + DEPTH_SHARE * depth
        return inside


class _Hidden:
    """What the arm has hidden from one camera since its tool rested, and what has been seen there since."""

    def __init__(self, shape: tuple[int, ...], box: tuple[slice, slice]) -> None:
        self.shape = shape
        """Of the camera's images."""
        self._box = box
        """Rows and columns that may show what is in the tool's space, or what was before it: [h, w] of the image."""
        self._arm = np.zeros(shape, np.bool_)[box]
        """[h, w] where the arm has been, and nothing has been measured since."""
        self._ground: Float32 = np.zeros(self._arm.shape, np.float32)
        """[h, w] m of the ground before the arm hid it, 0 where it was not known: what lies deeper is learnt as soon as
        it is measured, and the arm's rims are measured before they are looked at."""
        self._bared_at: NDArray[np.int64] = np.full(self._arm.shape, NEVER, np.int64)
        """[h, w] when the arm was first gone, ns."""
        self._depth: Float32 = np.zeros(self._arm.shape, np.float32)
        """[h, w] m of what was left, where that was measured of late; else 0."""

    @property
    def is_watched(self) -> bool:
        """Whether anything is still hidden, or has been bared of late."""
        return bool(self._arm.any() or self._depth.any())

    def hide(self, robot: Bool, ground: Float32) -> None:
        """The arm rests, and hides `robot` [H, W]; of what is there it is known how deep it is, as `ground` [H, W]."""
        comes = robot[self._box] & ~self._arm
        self._ground[comes] = ground[self._box][comes]
        self._arm |= comes

    def bare(self, view: View, seen: Bool, is_left: IsLeft, ground: GroundDepth, found: Bool) -> None:
        """Adds to `found` [H, W] what was left, of what is `seen` [H, W] in a view; `is_left` tells it of pixels,
        and `ground` how well the camera measures."""
        assert view.depth is not None
        seen, depth = seen[self._box], view.depth[self._box]
        bared = self._arm & seen
        self._bared_at[bared & (self._bared_at == NEVER)] = view.stamp
        told = bared & (depth > 0)
        rows, columns = np.nonzero(told)
        if len(rows):
            known = self._ground[rows, columns]
            left = is_left(rows + self._box[0].start, columns + self._box[1].start, known)
            rows, columns = rows[left], columns[left]
            self._depth[rows, columns] = depth[rows, columns]
        since = view.stamp - self._bared_at
        self._arm &= ~(told | (bared & (since > BLIND_NS)))
        apart = np.abs(depth - self._depth) > ground.slack(self._depth)
        self._depth[(since > SHADED_NS) | (seen & (depth > 0) & apart)] = 0
        found[self._box] |= seen & (self._depth > 0)
