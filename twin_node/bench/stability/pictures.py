"""Pictures of the present by the twin and without a model, against what a perfect camera would have shown."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.bench.contenders import OURS
from twin_node.bench.stability.shapes import LEFT_NS, Ghosts
from twin_node.bench.stability.shots import Shot
from twin_node.cell.rendering import Rendering
from twin_node.model import ModelImage
from twin_node.model.quality import moving_pixels, psnr, squared_error
from twin_node.nodes.report.quality import render_cloud, unit
from twin_node.scene import Bool, Camera, Float32, TwinState, UInt8, View

PICTURES = ("frozen_first_frame", "previous_image")
"""Pictures without a model."""
PICTURE_EVERY = 4
"""Every so many sets the pictures are looked at."""


@dataclass
class PictureTally:
    """Squared error of pictures on the pixels where something has changed since the first set."""

    squares: float = 0.0
    pixels: int = 0

    def add(self, error: NDArray[np.floating], chosen: Bool) -> None:
        """Takes in squared errors [H, W] (of colours from 0 to 1) on chosen pixels [H, W]."""
        self.squares += float(error[chosen].sum())
        self.pixels += int(np.count_nonzero(chosen))

    @property
    def psnr_db(self) -> float | None:
        """Over all pictures; None where nothing changed."""
        return psnr(self.squares / self.pixels) if self.pixels else None


@dataclass(frozen=True)
class _Past:
    """What a camera would have shown at a time."""

    stamp: int
    exact: Rendering
    moving: Bool


class Pictures:
    """Scores pictures set by set."""

    def __init__(self) -> None:
        self.ghosts = Ghosts()
        self._tallies = {name: PictureTally() for name in (OURS, *PICTURES)}
        self._first: dict[str, UInt8] = {}
        self._frozen: dict[str, Float32] = {}
        self._previous: dict[str, View] = {}
        self._past: dict[str, deque[_Past]] = {}
        self._sets = 0

    def add(self, shot: Shot, state: TwinState, render_frozen: Callable[[Camera], ModelImage]) -> None:
        """Takes in a set that went through the twin; every `PICTURE_EVERY`th is looked at."""
        self._sets += 1
        for view in state.frames.views:
            name = view.camera.name
            exact = shot.exact[name]
            past = self._past.setdefault(name, deque())
            past.append(_Past(view.stamp, exact, exact.shows(shot.rig.world.moving_owners)))
            while past[-1].stamp - past[0].stamp > LEFT_NS:
                past.popleft()
            if name not in self._first:
                self._first[name], self._frozen[name] = exact.rgb, render_frozen(view.camera).rgb
            elif self._sets % PICTURE_EVERY == 0:
                ours = render_cloud(state.gaussians, view.camera, (view.stamp - state.model_stamp) * 1e-9)
                without = dict(zip(PICTURES, (self._frozen[name], unit(self._previous[name])), strict=True))
                self._score(self._first[name], past[0], past[-1], {OURS: ours, **without})
            self._previous[name] = view

    def psnr_db(self) -> dict[str, float]:
        """Per way to make pictures, on the pixels that have changed since the first set; empty where none has."""
        known = {name: tally.psnr_db for name, tally in self._tallies.items()}
        return {name: value for name, value in known.items() if value is not None}

    def _score(self, first: UInt8, before: _Past, now: _Past, pictures: dict[str, Float32]) -> None:
        exact = now.exact.rgb.astype(np.float32) / np.float32(255)
        changed = moving_pixels(exact, first.astype(np.float32) / np.float32(255))
        for name, picture in pictures.items():
            self._tallies[name].add(squared_error(picture, exact), changed)
        self.ghosts.add(now.exact.rgb, before.exact.rgb, before.moving & ~now.moving, pictures)
