"""What stands still in a recording: each camera's temporal median, free of whatever passes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from twin_node.rig.calibrate.lenses import pixel_rays
from twin_node.rig.errors import RigError
from twin_node.rig.undistort import distort
from twin_node.scene import Bool, Float32, FrameSet, Rig, RigCamera, UInt8, View

MOST_IMAGES = 80
"""Images per camera that a median is taken of: beyond that it changes by less than a grey level."""
LEAST_IMAGES = 3
STILL_LEVELS, STILL_SHARE = 20, 0.6
"""A pixel stands still where so large a share of its values is within so many grey levels of the median."""
RIM_LEVELS = 12
"""Darkest and, with the noise of compression, brightest that a rim without a picture is: bands of a video, the outside
of a fisheye's circle."""
RIM_REACH = 1 / 60
"""How far, as a share of an image's longer side, what is found beside a rim is found for its edge."""


@dataclass(frozen=True)
class Still:
    """A camera's raw image without what moves."""

    camera: RigCamera
    rgb: UInt8
    """[H, W, 3] median over time, distorted as the camera sees it."""
    still: Bool
    """[H, W] False where something else was seen too often for the median to be trusted, and at a black rim."""
    depth: Float32 | None = None
    """[H, W] median depth along the optical axis, m; 0 where unknown. None where the camera measures none."""


def stills_of(rig: Rig, sets: Iterable[FrameSet]) -> tuple[Still, ...]:
    """The still image of every camera of `rig` from sets of its raw (not undistorted) images at full size.

    Depth, raw too, is brought from the pixels of a camera's `depth_lens` onto those of its image.
    Long recordings are thinned evenly. Raises `RigError` naming a camera with too few images or of another size.
    """
    kept: dict[str, list[View]] = {camera.name: [] for camera in rig.cameras}
    step = 1
    for i, frames in enumerate(sets):
        if i % step:
            continue
        for view in frames.views:
            kept[view.camera.name].append(view)
        if max(map(len, kept.values())) >= 2 * MOST_IMAGES:
            kept = {name: views[::2] for name, views in kept.items()}
            step *= 2
    return tuple(_still(camera, kept[camera.name]) for camera in rig.cameras)


def _still(camera: RigCamera, views: list[View]) -> Still:
    images = [view.rgb for view in views]
    if len(images) < LEAST_IMAGES:
        raise RigError(
            f"camera {camera.name}: expected at least {LEAST_IMAGES} images, found {len(images)}; "
            "record for longer to see what stands still"
        )
    if images[0].shape[:2] != (camera.height, camera.width):
        raise RigError(
            f"camera {camera.name}: expected raw images of {camera.width}x{camera.height}, found "
            f"{images[0].shape[1]}x{images[0].shape[0]}"
        )
    stack = np.stack(images)
    median = np.median(stack, axis=0).astype(np.uint8)
    near = np.zeros(median.shape[:2])
    for image in stack:
        near += cv2.inRange(cv2.absdiff(image, median), (0, 0, 0), (STILL_LEVELS - 1,) * 3) > 0
    still = (near > STILL_SHARE * len(stack)) & ~_at_rim(median)
    return Still(camera, median, still, _on_image(camera, _median_depth(views)))


def _at_rim(rgb: UInt8) -> Bool:
    """[H, W] what is black beside the picture, from a whole side of the image or from all its corners on, and what is
    near it: edges of rims are alike in all cameras. What is dark elsewhere, up to the border too, is the scene's."""
    black = rgb.max(axis=2) <= RIM_LEVELS
    _, labels = cv2.connectedComponents(black.astype(np.uint8), connectivity=4)
    corners = [(0, 0), (0, -1), (-1, 0), (-1, -1)]
    begins = [corner for corner in corners if all(black[each] for each in corners)]
    for side, corner in ((black[0], (0, 0)), (black[-1], (-1, 0)), (black[:, 0], (0, 0)), (black[:, -1], (0, -1))):
        begins += [corner] * bool(side.all())
    rim = np.isin(labels, [labels[corner] for corner in begins])
    reach = round(RIM_REACH * max(rim.shape))
    near: Bool = cv2.dilate(rim.astype(np.uint8), np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)) > 0
    return near


def _median_depth(views: list[View]) -> Float32 | None:
    """[H, W] of the depths that are known; None where less than half of the views have any."""
    depths = [view.depth for view in views if view.depth is not None]
    if 2 * len(depths) < len(views):
        return None
    stack = np.stack(depths).astype(np.float32)
    stack[stack == 0] = np.nan
    never = np.isnan(stack).all(axis=0)
    stack[0, never] = 0
    return np.asarray(np.nanmedian(stack, axis=0), np.float32)


def _on_image(camera: RigCamera, depth: Float32 | None) -> Float32 | None:
    """Depth [H, W] as it was measured, m, at the pixels of the camera's image; 0 where nothing was."""
    lens = camera.depth_lens
    if depth is None or lens is None:
        return depth
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    rays = pixel_rays(camera, np.stack([u.ravel(), v.ravel()], axis=1))
    scale = np.array([camera.width / lens.width, camera.height / lens.height])
    there = ((distort(lens, rays) + 0.5) * scale - 0.5).reshape(*depth.shape, 2).astype(np.float32)
    return np.asarray(cv2.remap(depth, there[..., 0], there[..., 1], cv2.INTER_NEAREST), np.float32)
