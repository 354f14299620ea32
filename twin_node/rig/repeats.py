"""Tells a camera that hangs: it sends the same image again and again under new stamps, and all seems to stand still."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from twin_node.scene import Bool, Float32, UInt8, View

REPEATS = 2
"""Images in a row like the one before them that are no accident: to keep a rate, some cameras send each image twice."""
LIVELY = 8
"""Images in a row that differed from the one before all over: what a sensor's noise does, and no scene that moves."""
STEP, PARTS = 4, 4
"""One pixel in so many is compared, and the image is counted in so many parts, both across and down."""
NOISY_SHARE = 0.05
"""Share of a part's pixels that differ where there is noise; dark and burnt-out parts, where none is, may be half."""


@dataclass
class Repeats:
    """One stream of a camera, of colour or of depth."""

    repeats: int = 0
    """Images in a row, up to the last, that were like the one before to the bit."""
    changed: bool = False
    """Whether any ever was not."""
    lively: int = 0
    """Images in a row, as of the last that changed, that differed all over."""
    _last: UInt8 | Float32 | None = None

    def take(self, image: UInt8 | Float32 | None) -> None:
        """The next image [H, W, ...]; None where this one has none: what is not sent shows nothing that is past."""
        if image is None:
            self.repeats = 0
            return
        before, self._last = self._last, image
        if before is None or before.shape != image.shape:
            return
        differs = before[::STEP, ::STEP] != image[::STEP, ::STEP]
        if differs.any() or not np.array_equal(before, image):
            self.repeats, self.changed = 0, True
            self.lively = self.lively + 1 if _all_over(differs) else 0
        elif image.min() < image.max():  # a black image, or depth without any, shows nothing and vouches for nothing
            self.repeats += 1

    def hangs(self, beside_lively: bool) -> bool:
        """Whether the stream stands; `beside_lively`: another camera's images have the noise that this one lacks.

        Images without noise (simulated ones, videos whose coder skips what stands) are alike where nothing moves.
        """
        if self.lively >= LIVELY:
            return self.repeats >= REPEATS
        return beside_lively and not self.changed and self.repeats >= LIVELY


@dataclass
class Streams:
    """Both streams of a camera."""

    colour: Repeats = field(default_factory=Repeats)
    depth: Repeats = field(default_factory=Repeats)
    since: int = 0
    """Stamp of the last image that was new, ns."""

    def take(self, view: View) -> None:
        """The camera's next view."""
        self.colour.take(view.rgb)
        self.depth.take(view.depth)
        if not (self.colour.repeats or self.depth.repeats):
            self.since = view.stamp

    def hang(self, others: list[Streams]) -> bool:
        """Whether either stream stands; `others`: of the rig's other cameras."""
        return self.colour.hangs(any(other.colour.lively >= LIVELY for other in others)) or self.depth.hangs(
            any(other.depth.lively >= LIVELY for other in others)
        )


def _all_over(differs: Bool) -> bool:
    """Whether half of the image's parts hold pixels [H, W, ...] that differ."""
    pixels = differs.any(axis=2) if differs.ndim == 3 else differs
    parts = [part for row in np.array_split(pixels, PARTS) for part in np.array_split(row, PARTS, axis=1)]
    noisy = [bool(part.size) and float(part.mean()) >= NOISY_SHARE for part in parts]
    return 2 * sum(noisy) >= len(noisy)
