"""What an OAK knows of its colour camera's lens, and its depth on the pixels that this lens makes."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from twin_node.rig.calibrate.lenses import pixel_rays
from twin_node.rig.undistort import distort
from twin_node.scene import Bool, Float32, Float64, RigCamera

RATIONAL_COEFFICIENTS, FISHEYE_COEFFICIENTS = 8, 4
"""Of the 14 coefficients in OpenCV's order that a device stores, those that ROS's rational_polynomial and equidistant
have."""
_NOWHERE = 1e3
"""A ray (x/z) that no pixel has."""
_FOUND_PX = 0.5
"""A pixel's ray is found if it comes back so near to it: in the corners of a wide lens some have none."""


@dataclass(frozen=True)
class FactoryCalibration:
    """What a device knows of its colour camera from the factory."""

    K: Float64
    """[3, 3] px, OpenCV convention, for the size asked for."""
    D: Float64
    """[8] rational_polynomial, or [4] equidistant."""
    is_fisheye: bool = False
    """Whether it is the latter."""


def factory_calibration(handler: Any, socket: Any, width: int, height: int) -> FactoryCalibration | None:
    """The colour camera's calibration of a `depthai.CalibrationHandler`, scaled to an image size; None where none."""
    try:
        K = np.array(handler.getCameraIntrinsics(socket, width, height), dtype=np.float64)
        D = np.array(handler.getDistortionCoefficients(socket), dtype=np.float64)
        is_fisheye = handler.getDistortionModel(socket).name == "Fisheye"
    except RuntimeError:  # depthai's word for a camera that was never calibrated
        return None
    padded = np.zeros(FISHEYE_COEFFICIENTS if is_fisheye else RATIONAL_COEFFICIENTS)
    padded[: min(len(D), len(padded))] = D[: len(padded)]
    return FactoryCalibration(K, padded, is_fisheye)


class DepthBender:
    """Brings depth onto the pixels of the colour image as it comes, bent by its lens.

    StereoDepth aligns depth with the colour image without its distortion; that image is not undistorted unless asked
    for (docs.luxonis.com, RGB-D and Camera). Frames that say otherwise of themselves are left as they are.
    """

    def __init__(self, calibration: FactoryCalibration | None) -> None:
        """None: of a camera that was never calibrated nothing is bent."""
        self._calibration = calibration if calibration is not None and calibration.D.any() else None
        self._places: dict[tuple[int, int], tuple[NDArray[np.int64], Bool]] = {}

    def __call__(self, depth: Float32, depth_frame: Any, colour_frame: Any) -> Float32:
        """Depth [H, W] m of one frame on the pixels of the other; 0 where it reaches none."""
        if self._calibration is None or _is_bent(depth_frame, False) or not _is_bent(colour_frame, True):
            return depth
        shape = (depth.shape[0], depth.shape[1])
        if shape not in self._places:
            self._places[shape] = _places(self._calibration, shape)
        places, inside = self._places[shape]
        return np.where(inside, depth.reshape(-1)[places], np.float32(0))


def _is_bent(frame: Any, unless_told: bool) -> bool:
    """Whether a frame says that its image is distorted."""
    told = frame.getTransformation()
    return bool(np.any(told.getDistortionCoefficients())) if told.isValid() else unless_told


def _places(lens: FactoryCalibration, shape: tuple[int, int]) -> tuple[NDArray[np.int64], Bool]:
    """Per pixel of the image as it comes [H, W]: the flat index of it in the image without distortion, if in there."""
    height, width = shape
    model = "equidistant" if lens.is_fisheye else "rational_polynomial"
    camera = RigCamera("oak", width, height, lens.K, np.eye(4), model, lens.D)
    pixels = np.stack(np.meshgrid(np.arange(width), np.arange(height)), -1).reshape(-1, 2).astype(np.float64)
    rays = np.nan_to_num(pixel_rays(camera, pixels), nan=_NOWHERE)
    column, row = np.rint(rays * lens.K[[0, 1], [0, 1]] + lens.K[:2, 2]).reshape(height, width, 2).transpose(2, 0, 1)
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    again = distort(camera, rays)
    inside &= (np.abs(again - pixels).max(axis=1) < _FOUND_PX).reshape(height, width)
    places = np.where(inside, row * width + column, 0).astype(np.int64)
    return places, np.asarray(inside)
