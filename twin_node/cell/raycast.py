"""A ray caster for primitive solids: no graphics driver, the same bytes on every run.

Furniture is cast once per camera; each image casts only the rays inside the projected outline of every moving solid.
"""

from __future__ import annotations

import numpy as np

from twin_node.cell.casting import cast
from twin_node.cell.in_view import in_view
from twin_node.cell.rendering import Rendering
from twin_node.cell.solids import Solid
from twin_node.scene import Camera, Float32


class RayCaster:
    """Renders one camera's view of a cell: fixed furniture, and what moves in front of it."""

    def __init__(self, camera: Camera, furniture: tuple[Solid, ...]) -> None:
        self.camera = camera
        u, v = np.meshgrid(np.arange(camera.width) + 0.5, np.arange(camera.height) + 0.5)
        pixels = np.stack([u, v, np.ones_like(u)]).reshape(3, -1)
        rays = camera.T_base_cam[:3, :3] @ np.linalg.inv(camera.K) @ pixels
        self._rays: Float32 = rays.astype(np.float32).reshape(3, camera.height, camera.width)
        """Directions in `base_link` whose component along the optical axis is 1, so that ray parameters are depths."""
        self._background = Rendering.empty(camera.width, camera.height)
        self._background = self.render(furniture)

    def render(self, moving: tuple[Solid, ...]) -> Rendering:
        """The view with these solids added to the furniture."""
        rendering = self._background.copy()
        if moving:
            cast(self._rays, in_view(self.camera, moving), rendering)
        return rendering
