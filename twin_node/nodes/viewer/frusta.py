"""The cameras in the browser: where they stand, what they see, and on it the arm and the space that moves."""

from __future__ import annotations

from typing import Any

import numpy as np

from twin_node.errors import TwinError
from twin_node.geometry import quat_from_rotation
from twin_node.nodes.overlays import ARM_COLOUR, MOVING_COLOUR, arm_mask, moving_mask, tinted
from twin_node.nodes.snapshot import SILENT_S, Snapshot
from twin_node.robot import ArmModel
from twin_node.scene import Camera, UInt8, View

FRUSTUM_M = 0.12
"""Size of a camera's frustum as drawn, m."""


class Frusta:
    """A frustum per camera with its newest image."""

    def __init__(self, server: Any, arm: ArmModel) -> None:
        self._server = server
        self._arm = arm
        self._handles: dict[str, Any] = {}
        self._shown: dict[str, object] = {}
        self.is_shown = True
        self.is_masked = False
        """Whether the arm and the space that moves are tinted."""

    def set_cameras(self, cameras: tuple[Camera, ...]) -> None:
        """Shows these cameras from now on, and no others."""
        for handle in self._handles.values():
            handle.remove()
        self._handles = {camera.name: self._add(camera) for camera in cameras}
        self._shown.clear()

    def show(self, snapshot: Snapshot) -> None:
        """Puts the newest images into the frusta; an image that is there already is not sent again.

        Raises what is wrong with an image once those of all other cameras are there; with several, of the first.
        """
        problems: list[TwinError] = []
        for name, handle in self._handles.items():
            handle.visible = self.is_shown
            try:
                view = snapshot.view(name) if self.is_shown else None
                if view is not None:
                    self._put(view, snapshot)
            except TwinError as error:
                problems.append(error)
                view = None
            if view is None and self.is_shown and self._shown.pop(name, None) is not None:
                handle.image = None  # it had no image yet: the one that is there is of later
        if problems:
            raise problems[0]

    def _put(self, view: View, snapshot: Snapshot) -> None:
        """An image of long ago is dark: the camera sends no more."""
        name = view.camera.name
        is_old = snapshot.camera_silent_s(name) > SILENT_S
        look = view.stamp, self._masks_stamp(snapshot), is_old
        if self._shown.get(name) != look:
            image = self._masked(view, snapshot) if self.is_masked else view.rgb
            self._handles[name].image = np.asarray(image // 2) if is_old else image
            self._shown[name] = look

    def _add(self, camera: Camera) -> Any:
        return self._server.scene.add_camera_frustum(
            f"/cameras/{camera.name}",
            fov=float(2 * np.arctan2(camera.height / 2, camera.K[1, 1])),
            aspect=camera.width / camera.height,
            scale=FRUSTUM_M,
            color=ARM_COLOUR,
            wxyz=quat_from_rotation(camera.T_base_cam[:3, :3]),
            position=camera.T_base_cam[:3, 3],
            format="jpeg",
            cast_shadow=False,
            receive_shadow=False,
        )

    def _masks_stamp(self, snapshot: Snapshot) -> int | None:
        """What the masks are drawn for; None: there are none."""
        return snapshot.stamp if self.is_masked else None

    def _masked(self, view: View, snapshot: Snapshot) -> UInt8:
        image = view.rgb
        arm = arm_mask(snapshot, view.camera, self._arm, view.stamp)
        if arm is not None:
            image = tinted(image, arm, ARM_COLOUR)
        moving = moving_mask(snapshot, view.camera, 0)
        return image if moving is None else tinted(image, moving, MOVING_COLOUR)
