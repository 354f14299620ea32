"""What a camera sees where nothing moves, and where what stands still looks otherwise."""

from __future__ import annotations

from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.model.backgrounds import grow
from twin_node.model.birth_depths import BLOCK
from twin_node.model.kernel_requests import StillRequest
from twin_node.model.kernels import kernels
from twin_node.model.observation import Observed
from twin_node.model.parameters import MapParameters
from twin_node.model.quality import MOVING_THRESHOLD, largest_channel
from twin_node.native_library import addresses_of, thread_count
from twin_node.scene import Bool, Float32

UPTAKE = 0.3
"""Share of each image that enters what a pixel shows at rest: noise is averaged over about six images."""
WRONG_BY = 0.02
"""Difference (0 to 1) between background and image at rest that is worth a step: five grey levels, above the noise of
8-bit video. Beyond what steps have left over before, where there have been some."""
MOST_FILLS = 2
"""Times that one place is given new Gaussians before it changes again: what they do not mend, more will not."""

AROUND_PX = 3
"""Pixels around one within which another shows the same Gaussians."""


class Looked(NamedTuple):
    """What an image shows of what stands still, [H, W] each."""

    hidden: Bool
    """It shows something that moves, or nothing of use."""
    stirred: Bool
    """It looks otherwise than before, though it is not hidden."""
    counted: Bool
    """It has been at rest for long enough."""
    difference: Float32
    """Largest channel of |what is seen at rest - background|, 0 to 1."""


class Rest:
    """What one camera sees where nothing moves."""

    def __init__(self, one: Observed) -> None:
        """Begins with an image."""
        shape = one.rgb.shape[:2]
        self.camera = one.view.camera
        self.rgb = one.rgb.copy()
        """[H, W, 3] running mean of what pixels show at rest, 0 to 1."""
        self.depth = np.zeros(shape, np.float32)
        """[H, W] m, what was measured there last; 0 where unknown."""
        self.counted = np.zeros(shape, bool)
        """[H, W] pixels that had been at rest for long enough when it looked last."""
        self.hidden = np.zeros(shape, bool)
        """[H, W] pixels that show something that moves, or nothing of use."""
        self.wrong = np.zeros(shape, bool)
        """[H, W] those where the background looks otherwise and steps have not been in vain, and those around."""
        self.lacking = np.zeros(shape, np.float32)
        """[H, W] what steps have not made good although there was time for them, 0 to 1."""
        self._calm_s = np.zeros(shape, np.float32)
        self._filled = np.zeros(shape, np.uint8)
        self._tries = np.zeros(shape, np.int32)
        self._settled = np.zeros(shape, np.float32)
        self._stamp = one.view.stamp

    def see(self, one: Observed, parameters: MapParameters) -> None:
        """Takes in an image."""
        since_s = np.float32((one.view.stamp - self._stamp) * 1e-9)
        self._stamp = one.view.stamp
        looked = self.look(one, since_s, np.float32(parameters.calm_s))
        self.hidden, self.counted = looked.hidden, looked.counted
        self._find_wrong(cv2.blur(looked.difference, (3, 3)).astype(np.float32), parameters)
        for of in (self._filled, self._settled, self._tries):
            of[looked.stirred] = 0
        patient = (self._calm_s > parameters.patience_s) & (self._filled < MOST_FILLS)
        self.lacking = np.where(patient, cv2.blur(looked.difference - one.misfit, (3, 3)), np.float32(0))

    def look(self, one: Observed, since_s: np.float32, calm_s: np.float32) -> Looked:
        """Brings up to date what is seen at rest, `since_s` after the image before; at rest is who is for `calm_s`."""
        library = kernels()
        if library is None:
            return self.look_reference(one, since_s, calm_s)
        shape = self._calm_s.shape
        looked = Looked(*(np.empty(shape, kind) for kind in (bool, bool, bool, np.float32)))
        given: list[NDArray[Any] | None] = [one.rgb, one.background.rgb, one.usable, one.near_moving, one.view.depth]
        held = [None if of is None else np.ascontiguousarray(of) for of in given]
        held += [self.rgb, self.depth, self._calm_s, *looked]
        rules = (MOVING_THRESHOLD, UPTAKE, since_s, calm_s)
        library.run(StillRequest(self._calm_s.size, thread_count(), *rules, *addresses_of(*held)))
        return looked

    def look_reference(self, one: Observed, since_s: np.float32, calm_s: np.float32) -> Looked:
        """The same in NumPy: the reference of the compiled kernel."""
        change = largest_channel(one.rgb, self.rgb)
        hidden = ~one.usable | one.near_moving
        calm = ~hidden & (change < MOVING_THRESHOLD)
        self._calm_s = np.where(calm, self._calm_s + since_s, np.float32(0))
        self.rgb += np.where(calm, np.float32(UPTAKE), np.float32(1))[..., None] * (one.rgb - self.rgb)
        if one.view.depth is not None:
            self.depth = np.where(calm & (one.view.depth > 0), one.view.depth, self.depth)
        difference = largest_channel(self.rgb, one.background.rgb)
        return Looked(hidden, ~hidden & ~calm, self._calm_s > calm_s, difference)

    def _find_wrong(self, missed: Float32, parameters: MapParameters) -> None:
        """Where more is `missed` [H, W] than steps leave over.

        What is left after so many looks, in a pixel and around it, is what it takes from then on to be wrong again, and
        half a threshold more: neighbours that share a Gaussian would take turns without end.
        """
        wrong = self.counted & (missed > self._settled + WRONG_BY)
        self._tries += wrong
        spent = grow(self._tries > parameters.tries, AROUND_PX)
        self._settled[spent] = np.maximum(self._settled, missed + np.float32(0.5 * WRONG_BY))[spent]
        self._tries[spent] = 0
        self.wrong = grow(wrong & ~spent, 1)

    def fill(self, rows: NDArray[np.intp], columns: NDArray[np.intp]) -> None:
        """The blocks of pixels that begin at `rows` and `columns` [n] have new Gaussians, which must learn first."""
        for down in range(BLOCK):
            for right in range(BLOCK):
                self._calm_s[rows + down, columns + right] = 0
                self._filled[rows + down, columns + right] += 1
