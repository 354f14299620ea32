"""How moving masks do against what truly moves: pixels that they miss, and marked ones that nothing moves near."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from twin_node.scene import Bool

NEAR_PX = 3
"""A marked pixel that many rows and columns from something that can move, or fewer, is its rim and not false."""
LASTING_NS = 500_000_000
"""Pixels that are false without a break for longer are lasting ones."""


@dataclass(frozen=True)
class ImageTruth:
    """What one image shows of all that can move but the arm, [H, W] each; no pixel is of two kinds.

    `mask_truth.MovingParts` tells what is of which kind.
    """

    moving: Bool
    rested: Bool
    waiting: Bool

    @property
    def all(self) -> Bool:
        """[H, W] whatever kind it is of."""
        return self.moving | self.rested | self.waiting


@dataclass(frozen=True)
class PixelKinds:
    """What a mask makes of the pixels of one image, [H, W] each."""

    moving: Bool
    """What moves and could be marked: not behind the arm's mask, nor where the image is invalid."""
    missed: Bool
    """What of that is not marked."""
    missed_rested: Bool
    """The same of what has come to rest."""
    missed_waiting: Bool
    """The same of what has yet to move: nobody can tell it from furniture."""
    right: Bool
    """Marked, of whatever can move."""
    false: Bool
    """Marked, with nothing that can move near (`NEAR_PX`)."""


@dataclass(frozen=True)
class ImageScore:
    """Pixels of one image by `PixelKinds`."""

    stamp: int
    """Of the image, ns."""
    moving: int
    missed: int
    missed_rested: int
    missed_waiting: int
    right: int
    false: int


@dataclass(frozen=True)
class MaskFigures:
    """Pixels by `PixelKinds`, means over images; a share of no pixels at all is None."""

    images: int
    moving_px: float | None
    missed_px: float | None
    missed_share: float | None
    """Of the moving pixels of all images."""
    missed_rested_px: float | None
    missed_waiting_px: float | None
    false_px: float | None
    false_share: float | None
    """As a share of the moving pixels of all images."""
    false_lasting_share: float | None
    """What of the false pixels is lasting (`LASTING_NS`)."""


def compare(mask: Bool, truth: ImageTruth, seen: Bool) -> PixelKinds:
    """Holds a mask [H, W] against the truth; `seen` [H, W]: the pixels that it may mark."""
    near = cv2.dilate(truth.all.astype(np.uint8), np.ones((2 * NEAR_PX + 1, 2 * NEAR_PX + 1), np.uint8)) > 0
    unmarked = seen & ~mask
    return PixelKinds(
        moving=truth.moving & seen,
        missed=truth.moving & unmarked,
        missed_rested=truth.rested & unmarked,
        missed_waiting=truth.waiting & unmarked,
        right=mask & truth.all,
        false=mask & ~near,
    )


class MaskTally:
    """The masks of one camera, image by image in rising order of stamps."""

    def __init__(self, height: int, width: int) -> None:
        self.images: list[ImageScore] = []
        self.lasting = 0
        """False pixels that are lasting ones, each counted in every image that it is false in."""
        self._since = np.zeros((height, width), np.int64)
        self._uncounted = np.zeros((height, width), np.int64)
        """Images in which a pixel has been false without a break, those left out that `lasting` counts."""
        self._last = np.zeros((height, width), np.bool_)

    def add(self, stamp: int, kinds: PixelKinds) -> None:
        """Takes in what the mask made of the image of a stamp, ns."""
        counts = {name: int(np.count_nonzero(pixels)) for name, pixels in vars(kinds).items()}
        self.images.append(ImageScore(stamp, **counts))
        self._since[kinds.false & ~self._last] = stamp
        self._uncounted = np.where(kinds.false, self._uncounted + 1, 0)
        lasting = kinds.false & (stamp - self._since > LASTING_NS)
        self.lasting += int(self._uncounted[lasting].sum())
        self._uncounted[lasting] = 0
        self._last = kinds.false


def figures_of(tallies: Iterable[MaskTally]) -> MaskFigures:
    """Over all images of some cameras and runs, each of the same weight."""
    known = list(tallies)
    images = [image for tally in known for image in tally.images]
    count = len(images)
    moving, missed, rested, waiting, false = (
        sum(getattr(image, name) for image in images)
        for name in ("moving", "missed", "missed_rested", "missed_waiting", "false")
    )
    return MaskFigures(
        images=count,
        moving_px=_share(moving, count),
        missed_px=_share(missed, count),
        missed_share=_share(missed, moving),
        missed_rested_px=_share(rested, count),
        missed_waiting_px=_share(waiting, count),
        false_px=_share(false, count),
        false_share=_share(false, moving),
        false_lasting_share=_share(sum(tally.lasting for tally in known), false),
    )


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None
