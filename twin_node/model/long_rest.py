"""What moved in one camera's images and has kept still for so long that it stands, as if it had from the start."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.model.camera_mask import CHANGE_LEVELS, CHANGE_SIGMAS, CameraMask, seen_by
from twin_node.scene import Bool, Float32, View

STANDS_NS = 20_000_000_000
"""How long a thing must have looked the same, ns: longer than people keep as still as that, a hand on a table too, and
than most things wait that are moved again; as long as what has moved is given room to start."""
MOST_UNSEEN_NS = 1_000_000_000
"""From one image to the next no more of the time counts, ns: what nobody has looked at for longer may have moved
meanwhile, and look again as it did."""
LOOK_NS = 500_000_000
"""Time between two looks for what has come to rest, ns, each at two images in a row: what turns may look the same at
every look. What has come to rest is looked at in every image."""
RENEWED_NS = 2_000_000_000
"""Time after which what stands is compared with how it looks by then, ns."""
WHOLE = 0.95
"""Share of a thing's pixels that must have; the rest is noise, if it is scattered."""
HAND_M = 0.04
"""Width from which on what has not is a hand that moves, m, however large all is that hangs together with it."""
NOISE_PX = 1.2
"""A pixel is noise that has no more about it that moved: radius of one, with half of the next, pixels."""
MEASURED = 0.5
"""Share of them whose depth must be known: without it nobody but the mask would know that something is there."""


class LongRest:
    """Follows for how long one camera's pixels have shown the same."""

    def __init__(self) -> None:
        self._shown: _Shown | None = None
        """None while nothing is in the mask."""
        self._looks_again = False
        """Whether the image before was looked at, and the one before that was not."""
        self._standing: Bool | None = None
        """[H, W] what was left out of the last mask, and what of it the arm has hidden since; None: nothing."""

    def without(self, mask: Bool, camera: CameraMask, view: View, robot: Bool | None) -> Bool:
        """The mask [H, W] of `view` without the things that have come to rest for long.

        These are in it again with the first image that shows them otherwise. What is behind the arm is taken to be as
        it was.
        """
        seen = seen_by(view, robot)
        hidden = None if self._standing is None else _or_none(self._standing & ~seen)
        if not mask.any():
            self._standing, self._looks_again = hidden, False
            self._shown = None if hidden is None else self._shown
            return mask
        stamp, image = camera.past[-1]
        if self._shown is None:
            self._shown = _Shown(stamp, image, view.depth)
            return mask
        self._shown.skip(unseen_ns(camera.past[-2][0], stamp))
        if self._standing is None and not self._looks_again and stamp - self._shown.looked_at < LOOK_NS:
            return mask
        self._looks_again = not self._looks_again
        self._shown.look(stamp, image, camera, view.depth, seen)
        standing = _whole(mask, self._shown, view.camera.K[0, 0])
        self._standing = _or_none(standing if hidden is None else standing | hidden)
        if not standing.any():
            return mask
        self._shown.renew(standing)
        return mask & ~standing


def unseen_ns(before: int, now: int) -> int:
    """How much of the time (ns) from one image, or set, to the next does not count as having kept still."""
    return max(now - before - MOST_UNSEEN_NS, 0)


class _Shown:
    """What each pixel has shown for some time, and since when."""

    def __init__(self, stamp: int, image: Float32, depth: Float32 | None) -> None:
        self.looked_at = self._renewed_at = stamp
        self._image = image.copy()
        self.depth: Float32 = np.zeros(image.shape[1:], np.float32) if depth is None else depth.astype(np.float32)
        """[H, W] m; 0 where none has been measured since."""
        self._since: NDArray[np.int64] = np.full(image.shape[1:], stamp, np.int64)
        self._newest = image

    @property
    def rests(self) -> Bool:
        """[H, W] what has shown the same for long."""
        return np.asarray(self.looked_at - self._since > STANDS_NS)

    def skip(self, unseen: int) -> None:
        """What does not rest yet has done so for no longer by a time (ns) in which nobody has looked."""
        if unseen:
            self._since[~self.rests] += unseen

    def look(self, stamp: int, image: Float32, camera: CameraMask, depth: Float32 | None, seen: Bool) -> None:
        """Takes in an image [3, H, W] and its depth, where they are `seen` [H, W]."""
        self.looked_at, self._newest = stamp, image
        threshold = max(CHANGE_LEVELS, CHANGE_SIGMAS * camera.sigma)
        changed = _differs(image, self._image, threshold)
        if depth is not None:
            apart = np.abs(depth - self.depth) > camera.depth.slack(self.depth)
            apart &= (depth > 0) & (self.depth > 0)
            changed |= cv2.morphologyEx(apart.astype(np.uint8), cv2.MORPH_OPEN, _CROSS) > 0
        changed &= seen
        self._since[changed] = stamp
        np.copyto(self._image, image, where=changed)
        if depth is not None:
            np.copyto(self.depth, depth, where=changed | (seen & (self.depth == 0)))

    def renew(self, standing: Bool) -> None:
        """Lets what stands change slowly, as light does: now and then it is compared with how it looks by now."""
        if self.looked_at - self._renewed_at > RENEWED_NS:
            self._renewed_at = self.looked_at
            np.copyto(self._image, self._newest, where=standing)


def _whole(mask: Bool, shown: _Shown, focal_px: float) -> Bool:
    """[H, W] the connected regions of a mask that have come to rest as a whole, hands too."""
    rests = shown.rests
    if not (mask & rests).any():
        return np.zeros_like(mask)
    count, labels = cv2.connectedComponents(mask.astype(np.uint8))
    sizes, resting, measured = (
        np.bincount(labels[of], minlength=count) for of in (mask, mask & rests, mask & (shown.depth > 0))
    )
    stands = (resting >= WHOLE * sizes) & (measured >= MEASURED * sizes)
    stands[labels[hands(mask & ~rests, shown.depth, focal_px)]] = False
    stands[0] = False
    found: Bool = stands[labels]
    return found


def hands(moved: Bool, depth: Float32, focal_px: float) -> Bool:
    """[H, W] the middles of what has `moved` that is as wide as a hand; what is not measured is as far as any."""
    radii = cv2.distanceTransform(moved.astype(np.uint8), cv2.DIST_L2, 3)
    far = np.where(depth > 0, depth, depth.max())
    return np.asarray((radii > NOISE_PX) & (radii * far > HAND_M / 2 * focal_px))


def _or_none(mask: Bool) -> Bool | None:
    """A mask in which there is anything."""
    return mask if mask.any() else None


def _differs(image: Float32, other: Float32, threshold: float) -> Bool:
    """[H, W] where some colour of two images [3, H, W] differs by more than a threshold."""
    return np.asarray((np.abs(image - other) > threshold).any(0))


_CROSS = cv2.getStructuringElement(cv2.MORPH_CROSS, (3, 3))
