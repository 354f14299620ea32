"""What every reader can be told, and images at the size that is asked for."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from twin_node.model.parameters import ModelError
from twin_node.picture_files import is_cut_jpeg, lacks_end, read_picture
from twin_node.scene import Float64, UInt8

NO_PINHOLE = ("FISHEYE", "EQUIRECTANGULAR")
"""In the names of camera models that are no pinholes even where all of their coefficients are 0."""
MOST_STRETCHED = 0.01
"""By how much an image's sides may be stretched apart: rounding to whole pixels does so to small ones."""


@dataclass(frozen=True)
class ReadOptions:
    """How much of a recording to read."""

    width: int | None = None
    """Width of the images in pixels, if smaller than their own; None: their own."""
    frames: int | None = None
    """Time steps to read, from the first; None: all."""
    hold_out: tuple[str, ...] | None = None
    """Cameras to keep for scoring; None: those of the layout's own convention."""


def load_image(path: Path) -> UInt8:
    """[H, W, 3 or 4] red, green, blue and, where the file has it, alpha. Raises `ModelError` naming the file."""
    is_there = path.is_file()
    image = read_picture(path, cv2.IMREAD_UNCHANGED) if is_there else None
    if image is None:
        found = "another kind of file" if is_there else "no file"
        raise ModelError(f"{path}: expected an image (PNG or JPEG), found {found}; complete the data set")
    packed = path.read_bytes()
    if lacks_end(packed) or is_cut_jpeg(packed, image):
        raise ModelError(f"{path}: expected a whole image, found a JPEG that is cut short; copy the data set again")
    if image.dtype == np.uint16:
        image = (image // 256).astype(np.uint8)
    if image.dtype != np.uint8:
        raise ModelError(f"{path}: expected 8 or 16 bits per channel, found {image.dtype}; convert it to PNG")
    if image.ndim == 2:
        image = np.repeat(image[..., None], 3, -1)
    order = [2, 1, 0, *range(3, image.shape[-1])]
    return np.ascontiguousarray(image[..., order])


def shrunk(image: UInt8, width: int | None) -> UInt8:
    """The image at `width` pixels where it is wider, with its own aspect; pixels that fall together are averaged."""
    if width is None or image.shape[1] <= width:
        return image
    height = max(round(image.shape[0] * width / image.shape[1]), 1)
    small: UInt8 = cv2.resize(image, (width, height), interpolation=cv2.INTER_AREA).astype(np.uint8)
    return small


def scaled_intrinsics(K: Float64, size: tuple[float, float], shape: tuple[int, int]) -> Float64:
    """Intrinsics [3, 3] for images of `size` (width, height) turned to `shape` (height, width); corner at 0, 0."""
    scaled: Float64 = np.diag([shape[1] / size[0], shape[0] / size[1], 1.0]) @ K
    return scaled


def refuse_other_shape(source: str, size: tuple[float, float], shape: tuple[int, int]) -> None:
    """Raises `ModelError` for images of a `shape` (height, width) that those of `size` (width, height) have not.

    They are cropped, or turned, and which part of them is left, intrinsics do not tell. `source` says whose they are.
    """
    height = size[1] * shape[1] / size[0]
    if abs(shape[0] - height) > max(1.0, MOST_STRETCHED * height):
        raise ModelError(
            f"{source}: expected images of the shape {size[0]:g}x{size[1]:g} that their camera is given for, found "
            f"{shape[1]}x{shape[0]}; give intrinsics for the images as they are"
        )
