"""How each camera is exposed beside the light of the model: told apart from what changes in the scene, and undone.

Light that is switched, flicker and a camera that hunts for its exposure change all pixels by one rule; what happens in
the scene changes some of them, each in its own way. Images are levelled before anything is made of them, so that the
model keeps its colours and nothing is born of a lamp.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np

from twin_node.model.first_light import is_blind
from twin_node.model.remembered import (
    DARKEST,
    FEWEST,
    QUANTUM,
    SATURATED,
    SLACK,
    Remembered,
    middle_ratios,
    ratios_of_middles,
)
from twin_node.scene import PLAIN, Bool, Exposure, Float32, FrameSet, UInt8, View

SAME = 0.02
"""Change of brightness under which an exposure is the same: a fifth of what counts as change in the scene. What creeps
slower than the memory of what a camera sees at rest stays below, and is for the model to learn."""
STRONGEST = 12.0
"""Gain, or its inverse, beyond which an image shows too little to be made good: three and a half stops."""
UNCERTAIN = 4.0
"""Gain, or its inverse, from which on it is worth a warning: two stops."""
EXPLAINED = 0.6
"""Share of the pixels at rest that an exposure must explain to be one: what changes less is something in the scene."""
OFFSET_SIGMA = 0.05
"""What offsets are like before anything is known, 1 sigma (0 to 1): lamps and shutters multiply, haze and gamma add."""
ROUNDS = 3
"""Fits, each to the pixels that the one before explains."""
HIDES = 0.1
"""Difference (0 to 1) that saturation may hide before a pixel tells nothing: what counts as change."""


@dataclass(frozen=True)
class Levelled:
    """A set as it would look in the light of the model."""

    frames: FrameSet
    exposures: tuple[Exposure, ...]
    """How each view was exposed beside that."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader must know: one line per camera whose images show little."""
        return tuple(
            f"camera {view.camera.name} shows {_times(exposure)} the light of the first set: it tells little; "
            "give the cell its light back or start the twin anew"
            for view, exposure in zip(self.frames.views, self.exposures, strict=True)
            if not 1 / UNCERTAIN <= exposure.gains.min() <= exposure.gains.max() <= UNCERTAIN
        )


class Exposures:
    """The exposure of every camera, estimated anew with every set."""

    def __init__(self) -> None:
        self._memories: dict[str, _Memory] = {}
        self._moving: dict[str, Bool] = {}
        """Per camera, [H, W] where something moved in its newest image."""

    def begin(self, frames: FrameSet, exposures: Sequence[Exposure]) -> Levelled:
        """The first set, whose cameras are known to be exposed like `exposures`, one per view."""
        views = tuple(levelled(view, exposure) for view, exposure in zip(frames.views, exposures, strict=True))
        for view, exposure in zip(views, exposures, strict=True):
            if not is_blind(view):
                self._memories[view.camera.name] = _Memory(view, exposure)
        return Levelled(replace(frames, views=views), tuple(exposures))

    def level(
        self, frames: FrameSet, robots: Sequence[Bool | None], joining: Callable[[View], Exposure] = lambda _: PLAIN
    ) -> Levelled:
        """`frames` in the light of the model; `robots` [H, W] per view is where the arm may be.

        A view that no one rule explains is taken to be exposed as its camera was at first. What `joining` says is asked
        of the first view that shows something of a camera that was not there when the model began, or has another size.
        """
        views, exposures = [], []
        for view, robot in zip(frames.views, robots, strict=True):
            memory = self._memories.get(view.camera.name)
            if memory is not None and memory.shape != view.rgb.shape:
                memory = None
            if memory is None and is_blind(view):
                exposures.append(PLAIN)
                views.append(view)
                continue
            if memory is None:
                first = joining(view)
                memory = self._memories[view.camera.name] = _Memory(levelled(view, first), first)
            still = _still(view, robot, self._moving.get(view.camera.name))
            exposures.append(memory.tell(view, still))
            views.append(memory.shown(view, exposures[-1], still))
            memory.take(views[-1], still)
        return Levelled(replace(frames, views=tuple(views)), tuple(exposures))

    def heed(self, frames: FrameSet, moving: Sequence[Bool]) -> None:
        """Tells where something moves in `frames`, [H, W] per view: those pixels do not count in the next image."""
        self._moving |= {view.camera.name: mask for view, mask in zip(frames.views, moving, strict=True)}


class _Memory:
    """What one camera sees at rest, in the light of the model."""

    def __init__(self, view: View, exposure: Exposure) -> None:
        """Of a `view` that has been levelled, as its camera was exposed like `exposure`."""
        self._rest = Remembered(view.rgb)
        self._first = self._last = exposure

    @property
    def shape(self) -> tuple[int, ...]:
        """Of its images."""
        return self._rest.shape

    def tell(self, view: View, still: Bool) -> Exposure:
        """How a view is exposed, by its pixels `still` [H, W]."""
        for one in (self._first,) if self._last is self._first else (self._first, self._last):
            ratios = self._rest.ratios(view.rgb, still, one)
            if ratios.still < FEWEST:
                return self._last
            if ratios.middle is not None and np.all(np.abs(ratios.middle - 1) < SAME):
                self._last = one
                return one
        self._last = fit_exposure(*self._rest.beside(view.rgb, still), self._first)
        return self._last

    def shown(self, view: View, exposure: Exposure, still: Bool) -> View:
        """A view in the light of the model.

        What is too bright to tell shows nothing. Where depth is measured that tells: the colour of what is `still`
        [H, W] stays as it was, what moves has the least that it can have.
        """
        even = levelled(view, exposure)
        if even is view or np.all((SATURATED * QUANTUM - exposure.offsets) / exposure.gains > 1 - HIDES):
            return even
        burnt: Bool = np.max(view.rgb, axis=-1) >= SATURATED
        cv2.copyTo(self._rest.newest, (burnt & still).astype(np.uint8), even.rgb)
        blind: Bool = burnt if view.depth is None else burnt & (view.depth <= 0)
        return replace(even, valid=~blind if view.valid is None else view.valid & ~blind)

    def take(self, even: View, still: Bool) -> None:
        """Takes in a view that has been levelled."""
        self._rest.take(even.rgb, still)


def fit_exposure(shown: Float32, seen: Float32, usual: Exposure) -> Exposure:
    """What makes colours `seen` [n, 3] of those `shown` in the model's light [n, 3], 0 to 1.

    The `usual` one where it explains more, or no one rule explains enough.
    """
    gains = middle_ratios(shown, seen)
    if gains is None:
        gains = ratios_of_middles(shown, seen)
    exposure = Exposure(usual.gains if gains is None else gains, np.zeros(3, np.float32))
    clear = seen < SATURATED * QUANTUM
    for _ in range(ROUNDS):
        exposure = _refit(shown, seen, (_explained(shown, seen, exposure) & clear).astype(np.float32), exposure.gains)
    if np.any(exposure.gains > STRONGEST) or np.any(exposure.gains < 1 / STRONGEST):
        return usual
    share, before = (_explained(shown, seen, one).all(1).mean() for one in (exposure, usual))
    return exposure if share > max(EXPLAINED, before) else usual


def is_clear(rgb: UInt8) -> Bool:
    """[...] which colours [..., 3] are neither too dark nor too bright to tell a ratio."""
    return np.asarray((rgb.max(-1) < SATURATED) & (rgb.min(-1) > DARKEST / QUANTUM), bool)


def levelled(view: View, exposure: Exposure) -> View:
    """A view in the light of the model, as far as its levels tell."""
    if exposure.is_plain:
        return view
    levels = (np.arange(256, dtype=np.float32)[:, None] * QUANTUM - exposure.offsets) / exposure.gains
    table = np.clip(levels / QUANTUM + np.float32(0.5), 0, 255).astype(np.uint8)
    return replace(view, rgb=cv2.LUT(view.rgb, table[None]).astype(np.uint8))


def _explained(shown: Float32, seen: Float32, exposure: Exposure) -> Bool:
    """[n, 3] colours that an exposure explains, as far as noise and the image's own steps tell."""
    error: Float32 = np.abs(exposure.of(shown) - seen)
    slack: Float32 = SLACK * exposure.gains + 2 * QUANTUM
    return np.asarray(error < slack)


def _refit(shown: Float32, seen: Float32, weights: Float32, gains: Float32) -> Exposure:
    """Least squares over the pixels of `weights` [n, 3]; a colour that all of them share leaves its gain at `gains`."""
    count = weights.sum(0) + (SLACK / OFFSET_SIGMA) ** 2
    square, mean = (weights * shown * shown).sum(0) + SLACK**2, (weights * shown).sum(0)
    both, target = (weights * shown * seen).sum(0) + SLACK**2 * gains, (weights * seen).sum(0)
    new = (both * count - mean * target) / (square * count - mean * mean)
    return Exposure(new.astype(np.float32), ((target - new * mean) / count).astype(np.float32))


def _still(view: View, robot: Bool | None, moving: Bool | None) -> Bool:
    """[H, W] pixels that show what stands still, as far as is known."""
    still = np.ones(view.rgb.shape[:2], bool) if view.valid is None else view.valid
    for mask in (robot, moving):
        if mask is not None and mask.shape == still.shape:
            still = still & ~mask
    return still


def _times(exposure: Exposure) -> str:
    """The middle gain in words, which stay the same as long as it does not change much."""
    return f"about {2.0 ** round(np.log2(exposure.brightness)):g} of"
