"""Turns raw camera images into pinhole images at working resolution."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Protocol

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.rig.errors import RigError
from twin_node.scene import Bool, Camera, Float32, Float64, Rig, RigCamera, UInt8, View

SUPERSAMPLING = 1.5
"""Least pixels per output pixel and axis that are interpolated before averaging: fine texture leaves no aliases."""
OTHER_SHAPE = 0.05
"""Difference between the shapes of depth and image, as a share of width by height, that is no driver's rounding."""


@dataclass(frozen=True)
class _PixelMap:
    """Where each output pixel is found in an input image, in the fixed-point form that `cv2.remap` is fastest with."""

    xy: NDArray[np.int16]
    fraction: NDArray[np.uint16]


class Undistorter:
    """Undistorts and scales the images of one camera; maps are computed once.

    The output keeps the focal length and principal point of the input, so a wide lens loses its rim. Raises `RigError`
    for a width that leaves less than two pixels either way.
    """

    def __init__(self, camera: RigCamera, width: int | None = None) -> None:
        """`width`: of the output in pixels; None: the camera's own. The height follows from the aspect ratio."""
        self._raw = camera
        self._depth_lens = camera.depth_lens or camera
        width = camera.width if width is None else width
        height = round(camera.height * width / camera.width)
        if min(width, height) < 2:
            raise RigError(f"camera {camera.name}: expected a working size of at least 2x2, found {width}x{height}")
        self.camera = Camera(
            *(camera.name, width, height, scaled_intrinsics(camera, width, height)),
            *(camera.T_base_cam.copy(), camera.sigma_m),
        )
        """The pinhole camera that the output was seen by."""
        self._distorted = not is_straight(camera)
        self._depth_maps: dict[tuple[int, int], tuple[NDArray[np.int64], Bool]] = {}
        self._valid: Bool | None = None
        if self._distorted:
            self._halvings = _halvings((camera.width, camera.height), (width, height))
            self._colour_map, self._valid = self._make_colour_map()

    def view(self, stamp: int, rgb: UInt8, depth: Float32 | None = None) -> View:
        """The undistorted view of an image [H, W, 3] and, where there is one, depth aligned with it.

        `depth` [h, w] is in metres along the optical axis, of any resolution that covers the same image, or what the
        camera's `depth_lens` sees; what is not a positive finite number becomes 0. Depth is picked, never averaged.

        Raises `RigError` where the image is not of the calibrated size, for depth in whole numbers, and for depth of
        another shape, which does not cover the same image.
        """
        raw = self._raw
        if rgb.shape != (raw.height, raw.width, 3) or rgb.dtype != np.uint8:
            found = "x".join(map(str, rgb.shape[1::-1])) + f" ({rgb.dtype}, {rgb.ndim} axes)"
            raise RigError(
                f"camera {raw.name}: expected 8-bit colour images of {raw.width}x{raw.height}, as calibrated, "
                f"found {found}; use the calibration of this resolution"
            )
        picked = None if depth is None else self._pick_depth(depth)
        return View(self.camera, stamp, self._colour(rgb), picked, self._valid)

    def see_depth_by(self, lens: RigCamera) -> None:
        """From now on depth is taken to be what another lens in the camera's place sees, see `RigCamera.depth_lens`.

        Other threads may be at work on views.
        """
        self._depth_lens, self._depth_maps = lens, {}  # in this order: what is made meanwhile is of the maps before

    def _colour(self, rgb: UInt8) -> UInt8:
        size = (self.camera.width, self.camera.height)
        if self._distorted:
            # Halving is far cheaper than any other area average: 0.4 ms of a 1080x1920 image against 6 ms to 320x569.
            for _ in range(self._halvings):
                rgb = _resize(rgb, (rgb.shape[1] // 2, rgb.shape[0] // 2))
            flat = cv2.remap(rgb, self._colour_map.xy, self._colour_map.fraction, cv2.INTER_LINEAR)
            return _resize(np.asarray(flat, dtype=np.uint8), size)
        return _resize(rgb, size)

    def _make_colour_map(self) -> tuple[_PixelMap, Bool | None]:
        """Map from the undistorted to the halved input, and which output pixels it covers (None: all)."""
        raw_size = (self._raw.width, self._raw.height)
        width, height = raw_size[0] >> self._halvings, raw_size[1] >> self._halvings
        source = _rescale(self._raw_pixels(self._raw, width, height), raw_size, (width, height)).astype(np.float32)
        within = (source > -0.5).all(-1) & (source < np.array([width - 0.5, height - 0.5])).all(-1)
        inside = self._reached(source, np.asarray(within))
        covered = _resize(np.where(inside, 255, 0).astype(np.uint8), (self.camera.width, self.camera.height))
        valid = covered == 255
        # Clamped to the rim, so that pixels inside by less than half a pixel are not mixed with black.
        source = np.clip(source, 0, np.array([width - 1, height - 1], dtype=np.float32))
        xy, fraction = cv2.convertMaps(source[..., 0], source[..., 1], cv2.CV_16SC2)
        return _PixelMap(np.asarray(xy, np.int16), np.asarray(fraction, np.uint16)), None if valid.all() else valid

    def _raw_pixels(self, lens: RigCamera, width: int, height: int) -> Float64:
        """Raw pixels (u, v) [height, width, 2] of a lens, OpenCV convention, that the output of such a size shows."""
        K = scaled_intrinsics(self._raw, width, height)
        u, v = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]], -1)
        return distort(lens, rays.reshape(-1, 2)).reshape(height, width, 2)

    def _reached(self, pixels: NDArray[np.floating], inside: Bool) -> Bool:
        """Which of the pixels `inside` [H, W] hang together, by such that the map does not fold, with the one that is
        nearest to the principal point.

        Beyond a fold a distortion polynomial may turn again: what it maps into the image there is a ghost.
        """
        height, width = inside.shape
        column, row = scaled_intrinsics(self._raw, width, height)[:2, 2]
        plain = inside & ~_folded(pixels)
        places = np.argwhere(plain)
        if not len(places):
            return plain
        middle = tuple(places[np.square(places - (row, column)).sum(1).argmin()])
        _, parts = cv2.connectedComponents(plain.astype(np.uint8), connectivity=4)
        return np.asarray(parts == parts[middle])

    def _pick_depth(self, depth: Float32) -> Float32:
        if depth.ndim != 2:
            raise RigError(f"camera {self._raw.name}: expected depth [H, W] in metres, found shape {list(depth.shape)}")
        if not np.issubdtype(depth.dtype, np.floating):
            raise RigError(
                f"camera {self._raw.name}: expected depth in metres as float32, found {depth.dtype}, as drivers give "
                "millimetres; divide by 1000.0"
            )
        shape = (depth.shape[0], depth.shape[1])
        maps = self._depth_maps
        if shape not in maps:
            maps[shape] = self._make_depth_map(shape)
        at, inside = maps[shape]
        picked = depth.ravel().take(at).astype(np.float32, copy=False)
        np.copyto(picked, 0, where=~(inside & (picked > 0) & (picked < np.inf)))
        return picked

    def _make_depth_map(self, shape: tuple[int, int]) -> tuple[NDArray[np.int64], Bool]:
        """Where [H, W] in the depth image, row by row, every output pixel's nearest is, and whether inside of it."""
        lens = self._depth_lens
        if abs(shape[1] * lens.height / (max(shape[0], 1) * lens.width) - 1) > OTHER_SHAPE:
            raise RigError(
                f"camera {self._raw.name}: expected depth of all that its image shows, so of the shape of "
                f"{lens.width}x{lens.height}, found {shape[1]}x{shape[0]}; let the driver align it with the image, or "
                "record it in the same mode"
            )
        pixels = self._raw_pixels(lens, self.camera.width, self.camera.height)
        source = np.rint(_rescale(pixels, (lens.width, lens.height), (shape[1], shape[0])))
        limit = np.array([shape[1] - 1, shape[0] - 1])
        inside = self._reached(pixels, np.asarray(((source >= 0) & (source <= limit)).all(-1)))
        columns, rows = np.moveaxis(np.clip(source, 0, limit).astype(np.int64), -1, 0)
        return rows * shape[1] + columns, inside


def without_distortion(rig: Rig) -> Rig:
    """The rig as if its lenses bent nothing: images read by it are raw ones, and so is depth: of a camera's
    `depth_lens`, where it has one, on the pixels of that, at the image's size."""
    straight = (replace(camera, distortion_model="plumb_bob", D=np.zeros(5), depth_lens=None) for camera in rig.cameras)
    return replace(rig, cameras=tuple(straight))


def scaled_intrinsics(camera: RigCamera, width: int, height: int) -> Float64:
    """`K` [3, 3] of a camera's image at another size, in gsplat's convention (top-left pixel centre at 0.5, 0.5)."""
    scale = np.array([[width / camera.width], [height / camera.height], [1.0]])
    K: Float64 = np.array(camera.K, dtype=np.float64)
    K[:2, 2] += 0.5
    scaled: Float64 = K * scale
    return scaled


class Optics(Protocol):
    """What maps rays to the pixels of an image: a camera of a rig, or its lens alone."""

    @property
    def width(self) -> int:
        """Of the image, pixels."""

    @property
    def height(self) -> int:
        """Of the image, pixels."""

    @property
    def K(self) -> Float64:
        """[3, 3] pixels, OpenCV convention."""

    @property
    def distortion_model(self) -> str:
        """ROS name: plumb_bob, rational_polynomial or equidistant."""

    @property
    def D(self) -> Float64:
        """Distortion coefficients in the model's own order."""


def is_straight(lens: Optics) -> bool:
    """Whether a lens bends nothing; a fisheye does without any coefficients too: angles are its image's radii."""
    return lens.distortion_model != "equidistant" and not np.any(lens.D)


def distort(camera: Optics, rays: Float64) -> Float64:
    """Raw image pixels [N, 2] (OpenCV convention) of rays (x/z, y/z) [N, 2] in the optical frame.

    Models: Brown-Conrady, that of `cv2.projectPoints`, for plumb_bob and rational_polynomial; Kannala-Brandt
    (`cv2.fisheye`) for equidistant.
    """
    if camera.distortion_model == "equidistant":
        K, D = (np.asarray(numbers, np.float64) for numbers in (camera.K, camera.D))  # OpenCV wants one kind of both
        pixels = cv2.fisheye.distortPoints(rays[:, None], K, D) if len(rays) else rays
        return np.asarray(pixels, dtype=np.float64).reshape(-1, 2)
    out: Float64 = _brown_conrady(camera.D, rays) * camera.K[[0, 1], [0, 1]] + camera.K[:2, 2]
    return out


def _brown_conrady(D: Float64, rays: Float64) -> Float64:
    """Rays (x/z, y/z) [N, 2] bent by coefficients [4, 5 or 8] in OpenCV's order; zeros may be of any number.

    `cv2.projectPoints` does the same with 14 derivatives of every point, and takes ten to twenty times as long.
    """
    D = D[:8]
    k1, k2, p1, p2, k3, k4, k5, k6 = np.pad(D, (0, 8 - len(D))).tolist()
    x, y = rays.T
    square, product = x * x + y * y, x * y
    radial = 1 + square * (k1 + square * (k2 + square * k3))
    if len(D) > 5:
        radial /= 1 + square * (k4 + square * (k5 + square * k6))
    across = x * radial + 2 * p1 * product + p2 * (square + 2 * x * x)
    down = y * radial + p1 * (square + 2 * y * y) + 2 * p2 * product
    return np.stack([across, down], axis=1)


def _folded(pixels: NDArray[np.floating]) -> Bool:
    """Where a map [H, W, 2] runs backwards: rays too far out for the distortion model, whose polynomial turns there."""
    du_dy, du_dx = np.gradient(pixels[..., 0])
    dv_dy, dv_dx = np.gradient(pixels[..., 1])
    return np.asarray((du_dx * dv_dy - du_dy * dv_dx <= 0) | (du_dx <= 0) | (dv_dy <= 0))


def _rescale(pixels: Float64, size: tuple[int, int], to: tuple[int, int]) -> Float64:
    """Pixels (OpenCV convention) of an image of `size` (width, height) in the same image scaled to size `to`."""
    scale = np.array(to) / np.array(size)
    scaled: Float64 = (pixels + 0.5) * scale - 0.5
    return scaled


def _halvings(size: tuple[int, int], to: tuple[int, int]) -> int:
    """How often an image of `size` (width, height) can be halved and still supersample the output size `to`."""
    count = 0
    while size[0] % 2 == size[1] % 2 == 0 and min(size[0] / to[0], size[1] / to[1]) >= 2 * SUPERSAMPLING:
        size, count = (size[0] // 2, size[1] // 2), count + 1
    return count


def _resize(image: UInt8, size: tuple[int, int]) -> UInt8:
    """The image at `size` (width, height): area-averaged when smaller, interpolated when larger."""
    if image.shape[1::-1] == size:
        return image
    method = cv2.INTER_AREA if size[0] < image.shape[1] else cv2.INTER_LINEAR
    resized: UInt8 = np.asarray(cv2.resize(image, size, interpolation=method), dtype=np.uint8)
    return resized
