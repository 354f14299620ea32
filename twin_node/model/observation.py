"""One set of images beside what the STATIC Gaussians alone would show: the evidence that every step works from."""

from __future__ import annotations

import ctypes
from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np

from twin_node.model.backgrounds import Background, grow
from twin_node.model.kernel_requests import ObservedView, ObserveRequest, ObserveRules
from twin_node.model.kernels import kernels
from twin_node.model.quality import MOVING_THRESHOLD, largest_channel
from twin_node.native_library import addresses_of, array_of, thread_count
from twin_node.scene import Bool, Float32, FrameSet, UInt8, View

MISFIT_GROWTH = 0.02
"""Noise (0 to 1) that the smallest misfit seen at a pixel is granted: five grey levels."""


@dataclass(frozen=True)
class Observed:
    """One view and what is known about its pixels."""

    view: View
    rgb: Float32
    """[H, W, 3] the image, 0 to 1."""
    offset_s: float
    """The view's stamp less the set's, s; never positive."""
    background: Background
    moving: Bool
    """[H, W] something moves or has moved."""
    near_moving: Bool
    """[H, W] `moving`, grown by what calibration and image noise can be wrong by."""
    usable: Bool
    """[H, W] pixels that count: valid and off the robot."""
    surprise: Float32
    """[H, W] largest channel of |image - background|, 0 to 1, less what the background's fit to the image at rest left
    over; 0 where the pixel does not count."""
    misfit: Float32
    """[H, W] what the background's fit to the image at rest left over, 0 to 1."""
    active: Bool
    """[H, W] pixels to be explained by more than the background: near what moves, or other than the background."""
    nearest: Float32 | None
    """[H, W] m: smallest depth measured in the 3 x 3 pixels around, so that edges refute nothing; 0 where unknown."""
    stale: Bool
    """[H, W] the background has been wrong here for a while although nothing moves: it has to be learnt anew."""


@dataclass(frozen=True)
class Pixels:
    """One view's pixels beside its background, before they are compared."""

    image: UInt8
    """[H, W, 3]."""
    background: Float32
    """[H, W, 3] 0 to 1."""
    usable: Bool
    """[H, W], see `Observed`, as the next one."""
    near_moving: Bool
    depth: Float32 | None
    """[H, W] m; 0 where it is not measured; None: nowhere."""
    before: Compared | None
    """Those of the set before; None where there are none of this size."""


@dataclass(frozen=True)
class Compared:
    """What a view differs by from its background; all but `wrong_s` as in `Observed`, images [H, W, ...]."""

    rgb: Float32
    surprise: Float32
    misfit: Float32
    wrong_s: Float32
    """[H, W] for how long the background has been wrong, s."""
    stale: Bool
    active: Bool
    nearest: Float32 | None


@dataclass(frozen=True)
class Comparing:
    """What counts as a difference."""

    elapsed_s: float
    """Since the set before, s."""
    stale_s: float
    """For how long the background may be wrong although nothing moves, s."""
    is_first: bool
    """Whether no set has been seen before: what the background's fit leaves over of it is no surprise."""


class Observer:
    """Puts a set's images, masks and backgrounds side by side; remembers for how long the background has been wrong."""

    def __init__(self, stale_s: float) -> None:
        self._stale_s = stale_s
        self._before: dict[str, Compared] = {}
        self._is_first = True

    def observe(
        self,
        frames: FrameSet,
        moving: Sequence[Bool],
        robots: Sequence[Bool | None],
        backgrounds: Sequence[Background],
        dt_s: float,
    ) -> list[Observed]:
        """What is known about each view of `frames`, `dt_s` after the set before."""
        rules = Comparing(dt_s, self._stale_s, self._is_first)
        self._is_first = False
        views = [self._pixels(*given) for given in zip(frames.views, moving, robots, backgrounds, strict=True)]
        found = compare(views, rules)
        self._before.update({view.camera.name: one for view, one in zip(frames.views, found, strict=True)})
        return [
            Observed(
                view,
                one.rgb,
                (view.stamp - frames.stamp) * 1e-9,
                background,
                mask,
                pixels.near_moving,
                pixels.usable,
                one.surprise,
                one.misfit,
                one.active,
                one.nearest,
                one.stale,
            )
            for view, mask, background, pixels, one in zip(frames.views, moving, backgrounds, views, found, strict=True)
        ]

    def _pixels(self, view: View, mask: Bool, robot: Bool | None, background: Background) -> Pixels:
        usable = np.ones(mask.shape, bool) if view.valid is None else view.valid
        usable = usable if robot is None else usable & ~robot
        before = self._before.get(view.camera.name)
        if before is not None and before.misfit.shape != mask.shape:
            before = None
        grown = grow(mask, background.margin_px)
        return Pixels(view.rgb, background.rgb, usable, grown, view.depth, before)


def compare(views: Sequence[Pixels], rules: Comparing) -> list[Compared]:
    """What views differ by from their backgrounds, beyond what the backgrounds' own fit to the first images left over.

    Nothing is left over where no fit was: there is no background yet behind the arm, or where no pixel was valid.
    """
    library = kernels()
    if library is None:
        return [compare_reference(one, rules) for one in views]
    given = ctypes.pointer(
        ObserveRules(MOVING_THRESHOLD, MISFIT_GROWTH, rules.elapsed_s, rules.stale_s, rules.is_first)
    )
    calls = [_Call(one) for one in views]
    asked = array_of(ObservedView, [call.view for call in calls])
    library.run(ObserveRequest(len(calls), thread_count(), given, asked))
    return [call.found for call in calls]


class _Call:
    """One view's request, and the arrays that it points to."""

    def __init__(self, one: Pixels) -> None:
        shape = one.usable.shape
        self.found = Compared(
            rgb=np.empty((*shape, 3), np.float32),
            surprise=np.empty(shape, np.float32),
            misfit=np.empty(shape, np.float32),
            wrong_s=np.empty(shape, np.float32),
            stale=np.empty(shape, bool),
            active=np.empty(shape, bool),
            nearest=None if one.depth is None else np.empty(shape, np.float32),
        )
        self._held = [np.ascontiguousarray(a) for a in (one.image, one.background, one.usable, one.near_moving)]
        self._depth = None if one.depth is None else np.ascontiguousarray(one.depth, np.float32)
        before = (None, None) if one.before is None else (one.before.misfit, one.before.wrong_s)
        arrays = (*self._held, self._depth, *before, *vars(self.found).values())
        self.view = ObservedView(shape[1], shape[0], *addresses_of(*arrays))


def compare_reference(one: Pixels, rules: Comparing) -> Compared:
    """The same of one view in NumPy: the reference of the compiled kernel."""
    rgb = np.divide(one.image, np.float32(255), dtype=np.float32)
    difference = largest_channel(rgb, one.background)
    nothing = np.zeros_like(difference)
    if one.before is None:
        known, before_s = difference * one.usable if rules.is_first else nothing, nothing
    else:
        known, before_s = one.before.misfit, one.before.wrong_s
    misfit = np.minimum(known, difference + np.float32(MISFIT_GROWTH))
    surprise: Float32 = np.maximum(difference - misfit, np.float32(0)) * one.usable
    wrong = surprise > MOVING_THRESHOLD
    wrong_s = np.where(wrong & ~one.near_moving, before_s + np.float32(rules.elapsed_s), np.float32(0))
    active = (one.near_moving | wrong) & one.usable
    return Compared(rgb, surprise, misfit, wrong_s, wrong_s > rules.stale_s, active, _nearest(one.depth))


def _nearest(depth: Float32 | None) -> Float32 | None:
    if depth is None:
        return None
    unknown = np.finfo(np.float32).max  # as far as cv2.erode goes: of infinity it makes that
    around = cv2.erode(np.where(depth > 0, depth, unknown), np.ones((3, 3), np.uint8))
    return np.where(around < unknown, around, np.float32(0)).astype(np.float32)
