"""The moving masks of a rig by the compiled kernels, its cameras side by side."""

from __future__ import annotations

from collections.abc import Sequence
from ctypes import pointer

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.model.camera_mask import (
    CHANGE_LEVELS,
    CHANGE_SIGMAS,
    GROUND_AROUND,
    GROUND_CERTAINTY,
    GROUND_LIKELIHOOD,
    GROWTH_PIXELS,
    REFLECTION_BRIGHTEST,
    SETTLE_NS,
    SHADOW_DARKEST,
    SMALLEST_AREA,
    CameraMask,
    seen_by,
)
from twin_node.model.ground_depth import DEPTH_LEVELS, LEARNING_RATE, LOST_NS, TELLING
from twin_node.model.kernel_requests import MaskRequest, MaskRequests, MaskRules
from twin_node.model.kernels import kernels
from twin_node.native_library import address_of, addresses_of, array_of, thread_count
from twin_node.scene import Bool, Float32, View
from twin_node.scene.depth_noise import MOST_NOISE, NOISE_SIGMAS

LARGEST_CLOSING = 31
"""Radius in pixels of the widest gaps that the kernels close, those of an image 1050 pixels high."""


def can_compile(cameras: Sequence[CameraMask] = ()) -> bool:
    """Whether the compiled kernels are at hand, and made for images as large as those of `cameras`."""
    small = all(camera.closing.shape[0] // 2 <= LARGEST_CLOSING for camera in cameras)
    return small and kernels() is not None


def update_compiled(cameras: Sequence[CameraMask], views: Sequence[View], robots: Sequence[Bool | None]) -> list[Bool]:
    """What `CameraMask.update` of each of `cameras` returns, and leaves behind."""
    library = kernels()
    assert library is not None
    calls = [_Call(*given) for given in zip(cameras, views, robots, strict=True)]
    requests = array_of(MaskRequest, [call.request for call in calls])
    library.run(MaskRequests(len(calls), thread_count(), requests))
    return [call.end() for call in calls]


class _Call:
    """One camera's request, and the arrays that it points to."""

    def __init__(self, camera: CameraMask, view: View, robot: Bool | None) -> None:
        self._camera = camera
        self._stamp = view.stamp
        self._image: Float32 = np.empty((3, *camera.shape), np.float32)
        self._sigma, self._bared = np.array([camera.sigma]), np.array([camera.bared])
        self._depth_noise = np.array([camera.depth.noise])
        self._rules = _rules(camera.closing)
        last_stamp, last = camera.past[-1]
        depth = camera.depth
        self._held: list[NDArray[np.generic] | None] = [
            cv2.GaussianBlur(view.rgb, (3, 3), 0),
            np.ascontiguousarray(seen_by(view, robot)),
            camera.reference(view.stamp),
            last,
            None if view.depth is None else np.ascontiguousarray(view.depth, dtype=np.float32),
            self._image,
            *(camera.background, depth.known, depth.measured, depth.telling, depth.blind_ns, camera.still_ns),
            *(camera.known, camera.trusted, camera.confirmed, camera.mask),
            *(camera.colours.ground, camera.colours.moving, self._sigma, self._bared, self._depth_noise),
        ]
        height, width = camera.shape
        sizes = (width, height, depth.is_silent(view), view.stamp - last_stamp)
        self.request = MaskRequest(*sizes, pointer(self._rules), *addresses_of(*self._held))

    def end(self) -> Bool:
        """Takes over what the kernel has found; returns the mask."""
        self._camera.sigma, self._camera.bared = float(self._sigma[0]), float(self._bared[0])
        self._camera.depth.noise = float(self._depth_noise[0])
        self._camera.remember(self._stamp, self._image)
        return self._camera.mask.copy()


def _rules(closing: NDArray[np.uint8]) -> MaskRules:
    return MaskRules(
        *(CHANGE_SIGMAS, CHANGE_LEVELS, SETTLE_NS, SMALLEST_AREA, SHADOW_DARKEST, REFLECTION_BRIGHTEST),
        *(GROUND_CERTAINTY, GROUND_LIKELIHOOD, GROUND_AROUND),
        *(LEARNING_RATE, DEPTH_LEVELS, NOISE_SIGMAS, MOST_NOISE, TELLING, LOST_NS),
        GROWTH_PIXELS,
        closing.shape[0] // 2,
        address_of(closing),
    )
