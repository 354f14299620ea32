"""Sets of images made smaller, where less is to be spent on them than they were prepared for."""

from __future__ import annotations

from dataclasses import dataclass, replace

import cv2
import numpy as np

from twin_node.scene import Bool, Camera, Float32, FrameSet, UInt8, View


@dataclass(frozen=True)
class _Narrowed:
    """A camera as it came, and the same at the width."""

    wide: Camera
    narrow: Camera


class Narrower:
    """Makes views at most `width` pixels wide; a camera's views keep one `Camera`, as those of a rig do."""

    def __init__(self, width: int) -> None:
        self._width = width
        self._cameras: dict[str, _Narrowed] = {}

    def narrowed(self, frames: FrameSet) -> FrameSet:
        """The set with every view narrowed."""
        return replace(frames, views=tuple(self.view(view) for view in frames.views))

    def view(self, view: View) -> View:
        """The view at the width; one that is no wider as it is.

        Colours are averaged, depth is that of the nearest pixel, and valid is what every pixel averaged was.
        """
        if view.camera.width <= self._width:
            return view
        camera = self._camera(view.camera)
        size = (camera.width, camera.height)
        rgb: UInt8 = cv2.resize(view.rgb, size, interpolation=cv2.INTER_AREA).astype(np.uint8)
        depth: Float32 | None = None
        if view.depth is not None:
            # INTER_NEAREST takes the upper left pixel of each block, half a narrow pixel off.
            depth = cv2.resize(view.depth, size, interpolation=cv2.INTER_NEAREST_EXACT).astype(np.float32)
        valid: Bool | None = None
        if view.valid is not None:
            valid = (
                cv2.resize(np.where(view.valid, np.uint8(255), np.uint8(0)), size, interpolation=cv2.INTER_AREA) == 255
            )
        return replace(view, camera=camera, rgb=rgb, depth=depth, valid=valid)

    def _camera(self, camera: Camera) -> Camera:
        known = self._cameras.get(camera.name)
        if known is None or known.wide is not camera:
            height = round(camera.height * self._width / camera.width)
            scale = np.diag([self._width / camera.width, height / camera.height, 1.0])
            narrow = Camera(camera.name, self._width, height, scale @ camera.K, camera.T_base_cam, camera.sigma_m)
            known = self._cameras[camera.name] = _Narrowed(camera, narrow)
        return known.narrow


class WholeNarrower:
    """Makes views smaller by whole factors; a camera's views keep one `Camera`, as those of `Narrower` do."""

    def __init__(self) -> None:
        self._by_width: dict[int, Narrower] = {}

    def view(self, view: View, factor: int) -> View:
        """The view with so many times fewer pixels each way; at a factor of 1 as it is."""
        width = view.camera.width // factor
        return self._by_width.setdefault(width, Narrower(width)).view(view)

    def down_to(self, view: View, least_width: int) -> View:
        """The view made as small as it can be while it stays at least so many pixels wide."""
        return self.view(view, max(view.camera.width // least_width, 1))


def narrowed_to(camera: Camera, mask: Bool) -> Bool:
    """The pixels of a narrowed camera in which there is something of a mask [H, W] of the wide one; or the mask."""
    if mask.shape == (camera.height, camera.width):
        return mask
    size = (camera.width, camera.height)
    return np.asarray(cv2.resize(np.where(mask, np.uint8(255), np.uint8(0)), size, interpolation=cv2.INTER_AREA) > 0)


def widened_to(camera: Camera, mask: Bool) -> Bool:
    """A mask of a narrowed camera in the pixels of the wide one; or the mask."""
    if mask.shape == (camera.height, camera.width):
        return mask
    size = (camera.width, camera.height)
    return np.asarray(cv2.resize(mask.view(np.uint8), size, interpolation=cv2.INTER_NEAREST_EXACT).view(np.bool_))
