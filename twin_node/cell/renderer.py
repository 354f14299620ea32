"""What a perfect camera would see of the cell: the interface of the renderers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from twin_node.cell.solids import Solid
from twin_node.scene import Bool, Camera, Float32, UInt8

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

    def shows(self, owners: tuple[int, ...]) -> Bool:
        """[H, W] True on the solids of these owners."""
        mask: Bool = np.isin(self.owners, owners)
        return mask


class Renderer(Protocol):
    """Draws one camera's view of fixed furniture and of what moves in front of it."""

    @property
    def camera(self) -> Camera:
        """The camera it draws for."""

    def render(self, moving: tuple[Solid, ...]) -> Rendering:
        """The view with these solids added to the furniture."""

    def outline(self, solids: tuple[Solid, ...]) -> Bool:
        """[H, W] True where these solids would be seen if nothing else were there."""
