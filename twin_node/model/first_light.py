"""Cameras that have not shown the scene at rest yet: black or burnt out, or come while somebody moves before others."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace

import numpy as np

from twin_node.model.remembered import DARKEST, QUANTUM, SATURATED
from twin_node.scene import FrameSet, View

TELLING = 0.02
"""Share of an image's pixels that must be neither black nor burnt out: a black image has some that are hot."""
PATIENCE_S = 2.0
"""How long a camera that measures depth is waited for, s: exposures settle within one, and the cell may be dark."""


class FirstLight:
    """Tells which cameras have shown something.

    The first image of a camera is taken for the scene at rest: beside a black one all that comes later would be in
    motion for good, and who stands in one without depth would be ground, and their place free.
    """

    def __init__(self) -> None:
        self._lit: dict[str, tuple[int, ...]] = {}
        """The size of their images, by name: one that comes with another is a new camera."""
        self._since: dict[str, int] = {}
        """Stamps of the first images of cameras that have shown nothing yet, ns."""
        self._newest: dict[str, int] = {}
        """Stamps of their newest images, ns."""
        self._unsettled: set[str] = set()
        """Of these, those that have come while something moves."""

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader must know: one line per camera that has come and is left out."""
        return tuple(f"camera {name} {_UNSETTLED if name in self._unsettled else _DARK}" for name in self._since)

    def heed(self, frames: FrameSet, is_still: bool = True) -> FrameSet:
        """`frames`, in which no pixel is valid of cameras that have shown nothing yet.

        Nor of those without depth that come while the scene is not `is_still`, before other cameras, or whose images
        have become larger or smaller then: what was known of the old pixels is not of the new ones. One that measures
        depth is left out for `PATIENCE_S` at most: depth tells in the dark, too. One that has been away for as long
        begins anew when it comes back.
        """
        self._let_go(frames)
        if all(self._knows(view) for view in frames.views):
            return frames
        views = tuple(view if self._is_lit(view, is_still) else _blind(view) for view in frames.views)
        return replace(frames, views=views)

    def is_dark(self, frames: FrameSet) -> bool:
        """Whether no camera of a set has shown anything so far, see `heed`."""
        return all(is_blind(view) for view in self.heed(frames).views)

    def begin(self, frames: FrameSet) -> FrameSet:
        """The first set that a model is made of: as `heed` has it, or whole where that would leave nothing of it."""
        if not self.is_dark(frames):
            return self.heed(frames)
        for view in frames.views:
            self._light(view)
        return frames

    def _knows(self, view: View) -> bool:
        return self._lit.get(view.camera.name) == view.rgb.shape[:2]

    def _is_lit(self, view: View, is_still: bool) -> bool:
        name = view.camera.name
        if self._knows(view):
            return True
        since, self._newest[name] = self._since.setdefault(name, view.stamp), view.stamp
        waited = view.depth is not None and view.stamp - since >= PATIENCE_S * 1e9
        self._unsettled.discard(name)
        if not waited and not shows_something(view):
            return False
        if view.depth is None and not is_still:
            self._unsettled.add(name)
            return False
        self._light(view)
        return True

    def _light(self, view: View) -> None:
        self._lit[view.camera.name] = view.rgb.shape[:2]
        self._forget(view.camera.name)

    def _let_go(self, frames: FrameSet) -> None:
        """Forgets cameras that have shown nothing, are not in a set, and have been away for long."""
        there = {view.camera.name for view in frames.views}
        for name, newest in list(self._newest.items()):
            if name not in there and frames.stamp - newest > PATIENCE_S * 1e9:
                self._forget(name)

    def _forget(self, name: str) -> None:
        """That a camera has shown nothing."""
        self._since.pop(name, None)
        self._newest.pop(name, None)
        self._unsettled.discard(name)


_DARK = "has shown nothing so far, black or burnt out: it is left out; uncover it, or mend the light"
_UNSETTLED = (
    "measures no depth and has come, or its images in another size, while something moves before others: who stands "
    "there would be ground to it, so it is left out until nothing moves; clear the cell, or start the twin anew with "
    "nobody in view"
)


def once_lit(sets: Iterable[FrameSet]) -> Iterator[FrameSet]:
    """Sets, in rising order of stamps, from the first on in which some camera shows something.

    For who makes a model of them: of one that begins in the dark all that comes later is in motion for good.
    """
    light, is_dark = FirstLight(), True
    for frames in sets:
        is_dark = is_dark and light.is_dark(frames)
        if not is_dark:
            yield frames


def shows_something(view: View) -> bool:
    """Whether enough of a view's valid pixels are neither black nor burnt out."""
    rgb = view.rgb if view.valid is None else view.rgb[view.valid]
    tells = (rgb.max(-1) > DARKEST / QUANTUM) & (rgb.min(-1) < SATURATED)
    return bool(tells.size) and float(tells.mean()) >= TELLING


def is_blind(view: View) -> bool:
    """Whether no pixel of a view is valid."""
    return view.valid is not None and not view.valid.any()


def _blind(view: View) -> View:
    return replace(view, valid=np.zeros(view.rgb.shape[:2], bool))
