"""What a perfect camera makes of the cell."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from twin_node.scene import Bool, Float32, UInt8

BACKDROP = (178, 184, 190)
"""R, G, B where no solid is."""

NOTHING = -1
"""Owner of the pixels that show no solid."""


@dataclass(frozen=True)
class Rendering:
    """A noiseless image."""

    rgb: UInt8
    """[H, W, 3]."""
    depth: Float32
    """[H, W] metres along the optical axis; 0 where no solid is."""
    owners: NDArray[np.int16]
    """[H, W] `Solid.owner` of the solid in view, `NOTHING` for none."""

    @classmethod
    def empty(cls, width: int, height: int) -> Rendering:
        """The backdrop alone, pixels."""
        rgb = np.empty((height, width, 3), np.uint8)
        rgb[:] = BACKDROP
        return cls(rgb, np.zeros((height, width), np.float32), np.full((height, width), NOTHING, np.int16))

    def copy(self) -> Rendering:
        """One that may be drawn into."""
        return Rendering(self.rgb.copy(), self.depth.copy(), self.owners.copy())

    def shows(self, owners: tuple[int, ...]) -> Bool:
        """[H, W] True on the solids of these owners."""
        mask: Bool = np.isin(self.owners, owners)
        return mask
