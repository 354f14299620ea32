"""Which pixels show something that moves or has moved: causal, from the images alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from twin_node.model.camera_mask import CameraMask, seen_by
from twin_node.model.compiled_mask import can_compile, update_compiled
from twin_node.model.long_rest import LongRest
from twin_node.model.parameters import ModelError
from twin_node.model.set_down import SetDown
from twin_node.robot import ArmModel
from twin_node.scene import Bool, FrameSet, View
from twin_node.scene.narrowing import WholeNarrower, narrowed_to, widened_to

WIDTH = 320
"""px: images of twice this width or more are looked at in pixels of 2 x 2 of theirs and more, down to this width. Their
colours are averaged, their depth is one pixel's. What counts as a moving thing is larger than that, noise is less, and
a set of 640 x 480 takes two fifths of the time."""
BARED_SHARE = 5e-3
"""Of an image: so much that something has moved off of late which had been there from the start is a thing."""
WITNESSES = 2
"""Cameras that must show so: one may take somebody who has come to rest for ground."""
STILL_SHARE = 0.015
"""Of an image: without depth rims of somebody who has gone may stay in it, up to a hundredth; somebody 5 m away takes
three, an arm 1.5 m away two."""
BARED_NS = 20_000_000_000
"""For so long what is left of that thing may go on to rest unseen, ns: as long as what rests is expected to start."""
FULL_SHARE = 0.8
"""Of what a camera sees: nobody who works there hides so much of it for `FULL_NS`."""
FULL_NS = 10_000_000_000
"""For so long a mask is full before that is told, ns."""
_FULL = (
    "camera {}: nearly all that it sees has moved for {:g} s and more, as where it shakes, or its light or noise is "
    "another than it was: all of that is an obstacle; mend it, or start the twin again with nobody in view"
)
_STOOD = (
    "model: something moved that had stood there since the first images, as cameras show that measure no depth: what "
    "still stands of it is taken for ground and told as free; keep clear, and begin with nobody in view"
)


class MovingMask:
    """Moving masks of a rig, image set by image set.

    Looks at images up to the present only; the first image of a camera is taken as the scene at rest until something
    in it moves. What moved and stopped stays in the mask, where depth is measured until it has kept still for long;
    uncovered ground leaves it once it is known to be ground, or has been seen for as long.
    """

    def __init__(self, arm: ArmModel | None = None) -> None:
        """`arm`: the one of the robot masks, with its tool: what that leaves where it rests is no moving thing."""
        self._set_down = SetDown(arm)
        self._narrower = WholeNarrower()
        self._cameras: dict[str, _Known] = {}
        self._stamp = 0
        self._bared_at: int | None = None
        self._full_since: dict[str, int] = {}
        """Stamps (ns) since when cameras' masks, by name, have been full."""
        self._full: tuple[str, ...] = ()
        """Cameras of the newest set whose masks have been so for long."""
        self.is_still = True
        """Whether the newest masks show nobody."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader of the newest masks must know."""
        is_recent = self._bared_at is not None and self._stamp - self._bared_at <= BARED_NS
        told = tuple(_FULL.format(name, FULL_NS * 1e-9) for name in self._full)
        return (_STOOD, *told) if is_recent else told

    def depth_noise_of(self, view: View) -> float:
        """1 sigma of the depth of a view's camera at 1 m, m; 0 until it has been measured."""
        known = self._cameras.get(view.camera.name)
        return 0.0 if known is None else known.mask.depth.noise

    def update(self, frames: FrameSet, robot_masks: Sequence[Bool | None]) -> tuple[Bool, ...]:
        """Masks [H, W] per view of `frames`, True where something moves or has moved; the robot is left out.

        `robot_masks`: per view [H, W] True on the arm and its margin, or None where the arm's joints are unknown.
        Raises `ModelError` for images or masks that are not of their camera's size.
        """
        for view, robot in zip(frames.views, robot_masks, strict=True):
            if misfit := view.misfit(robot=robot):
                raise ModelError(f"set {frames.sequence}: {misfit}")
        views = [self._narrowed(view) for view in frames.views]
        given_robots = zip(views, robot_masks, strict=True)
        robots = [None if robot is None else narrowed_to(view.camera, robot) for view, robot in given_robots]
        known = [self._known(*of) for of in zip(views, frames.views, strict=True)]
        cameras = [one.mask for one in known]
        self._set_down.heed(frames)
        left = [
            None if robot is None else self._set_down.left(view, robot, camera)
            for view, robot, camera in zip(views, robots, cameras, strict=True)
        ]
        given = list(zip(cameras, views, robots, strict=True))
        if can_compile(cameras):
            masks = update_compiled(cameras, views, robots)
        else:
            masks = [camera.update(view, robot) for camera, view, robot in given]
        self._stamp = frames.stamp
        if sum(camera.bared > BARED_SHARE * camera.mask.size for camera in cameras) >= WITNESSES:
            self._bared_at = frames.stamp
        handled = self._set_down.things(views, masks, left)
        masks = [_without(*of) for of in zip(masks, handled, cameras, views, strict=True)]
        found = zip(known, masks, given, strict=True)
        moving = tuple(one.rest.without(mask, *seen) for one, mask, seen in found)
        seen = zip(moving, views, robots, strict=True)
        self._full = tuple(
            view.camera.name for mask, view, robot in seen if self._has_long_been_full(mask, view, robot)
        )
        self.is_still = all(np.count_nonzero(mask) <= STILL_SHARE * mask.size for mask in moving)
        whole = zip(moving, frames.views, robot_masks, strict=True)
        return tuple(_widened(mask, view, robot) for mask, view, robot in whole)

    def _has_long_been_full(self, mask: Bool, view: View, robot: Bool | None) -> bool:
        """Whether nearly all that a camera sees beside the robot has been in its mask [H, W] for long."""
        count = np.count_nonzero(mask)
        if count == 0 or count < FULL_SHARE * np.count_nonzero(seen_by(view, robot)):
            self._full_since.pop(view.camera.name, None)
            return False
        return self._stamp - self._full_since.setdefault(view.camera.name, self._stamp) >= FULL_NS

    def _narrowed(self, view: View) -> View:
        """The view as it is looked at."""
        return self._narrower.down_to(view, WIDTH)

    def _known(self, view: View, whole: View) -> _Known:
        """What is known of the camera of a `view`, which came as the `whole`."""
        name, size = whole.camera.name, whole.rgb.shape[:2]
        if name not in self._cameras or self._cameras[name].size != size:
            self._cameras[name] = _Known(size, CameraMask(view), LongRest())
        return self._cameras[name]


@dataclass(frozen=True)
class _Known:
    """What is known of a camera."""

    size: tuple[int, ...]
    """Of its images as they come: one that comes with another is a new camera."""
    mask: CameraMask
    rest: LongRest


def _without(mask: Bool, handled: Bool | None, camera: CameraMask, view: View) -> Bool:
    """A camera's mask [H, W] without what its arm has `handled` [H, W], which is ground from now on."""
    if handled is None:
        return mask
    camera.take_for_ground(handled, view)
    return mask & ~handled


def _widened(mask: Bool, view: View, robot: Bool | None) -> Bool:
    """What was found in a narrowed view in the pixels of the whole one, without the robot."""
    if mask.shape == view.rgb.shape[:2]:
        return mask
    whole = widened_to(view.camera, mask)
    return whole if robot is None else whole & ~robot
