"""The cameras in the browser: where they stand, what they see, and on it the arm and the space that moves."""

from __future__ import annotations

from typing import Any

import numpy as np

from twin_node.forecast.score import projected
from twin_node.geometry import quat_from_rotation
from twin_node.nodes.playback import Snapshot
from twin_node.robot import ArmModel, robot_mask
from twin_node.scene import Bool, Camera, UInt8, View

FRUSTUM_M = 0.12
"""Size of a camera's frustum as drawn, m."""
ROBOT_COLOUR, MOVING_COLOUR = (26, 115, 232), (217, 48, 37)
TINT = 0.45
"""Share of a mask's colour in the image."""


class Frusta:
    """A frustum per camera with its newest image."""

    def __init__(self, server: Any, cameras: tuple[Camera, ...], arm: ArmModel) -> None:
        self._arm = arm
        self._handles = {camera.name: self._add(server, camera) for camera in cameras}
        self.is_shown = True
        self.is_masked = False
        """Whether the arm and the space that moves are tinted."""

    def show(self, snapshot: Snapshot) -> None:
        """Puts the newest images into the frusta."""
        for handle in self._handles.values():
            handle.visible = self.is_shown
        frames = snapshot.frames if self.is_shown else None
        for view in frames.views if frames is not None else ():
            self._handles[view.camera.name].image = self._masked(view, snapshot) if self.is_masked else view.rgb

    def _add(self, server: Any, camera: Camera) -> Any:
        return server.scene.add_camera_frustum(
            f"/cameras/{camera.name}",
            fov=float(2 * np.arctan2(camera.height / 2, camera.K[1, 1])),
            aspect=camera.width / camera.height,
            scale=FRUSTUM_M,
            color=ROBOT_COLOUR,
            wxyz=quat_from_rotation(camera.T_base_cam[:3, :3]),
            position=camera.T_base_cam[:3, 3],
            format="jpeg",
            cast_shadow=False,
            receive_shadow=False,
        )

    def _masked(self, view: View, snapshot: Snapshot) -> UInt8:
        image = view.rgb
        if snapshot.joints is not None:
            q = self._arm.ordered_positions(snapshot.joints)
            image = tinted(image, robot_mask(self._arm, q, view.camera), ROBOT_COLOUR)
        occupancy = snapshot.occupancy
        if occupancy is not None:
            moving = projected(view.camera, occupancy.grid, occupancy.layers[0].indices)
            image = tinted(image, moving, MOVING_COLOUR)
        return image


def tinted(image: UInt8, mask: Bool, colour: tuple[int, int, int]) -> UInt8:
    """The image with a mask [H, W] tinted."""
    out = image.astype(np.float32)
    out[mask] = (1 - TINT) * out[mask] + TINT * np.array(colour, np.float32)
    return np.asarray(out, np.uint8)
