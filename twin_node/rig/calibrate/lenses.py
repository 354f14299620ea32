"""How lenses map directions to pixels: the three models of ROS, with derivatives (OpenCV's projections)."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from twin_node.rig.rig_checks import DISTORTION_LENGTHS
from twin_node.rig.undistort import Optics, distort
from twin_node.scene import Bool, Float64, RigCamera

COEFFICIENTS = {model: max(lengths) for model, lengths in DISTORTION_LENGTHS.items()}
"""Distortion models and how many coefficients are calibrated of each."""

LEAST_ASPECT = 1e-3
"""A solver's step may try what no lens is, a negative focal length: it is then as unlikely as this aspect."""
ASPECT_SIGMA = 0.003
"""1 sigma of fy / fx: pixels of sensors are square; scaling by a video driver rounds to a pixel in 300 or more."""

CENTRE_SIGMA = 0.03
"""1 sigma of the principal point's distance from the middle of the image, as a share of its width: assumed; published
calibrations of webcams and industrial cameras lie within 0.04."""

DISTORTION_SIGMAS = {
    "plumb_bob": (0.5, 1.0, 0.001, 0.001, 1.0),
    "rational_polynomial": (5.0, 5.0, 0.005, 0.005, 5.0, 5.0, 5.0, 5.0),
    "equidistant": (0.5, 0.5, 0.5, 0.5),
}
"""1 sigma of each coefficient about 0 (assumed): wide for any lens on sale, but no room for the values of hundreds that
corners in the middle of the image leave open."""

BEHIND_M = 1e-3
"""Least depth that is projected, m."""

INVERSION_STOP = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 40, 1e-10)
"""Rounds of undoing the distortion, and the change that ends them: strong lenses need more than OpenCV's five."""

SAME_RAY = 1e-3
"""By which undoing the distortion misses the tangent of a ray that is in the image, at most: a pixel's part."""

NO_TURN = np.zeros(3)


@dataclass(frozen=True)
class Lens:
    """Intrinsics of one camera."""

    width: int
    height: int
    K: Float64
    """[3, 3] pixels, OpenCV convention."""
    distortion_model: str
    """ROS name: plumb_bob, rational_polynomial or equidistant."""
    D: Float64
    """Distortion coefficients in the model's own order."""

    @property
    def parameters(self) -> Float64:
        """fx, fy, cx, cy (pixels) and the distortion coefficients, in one array [4 + D]."""
        return np.concatenate([[self.K[0, 0], self.K[1, 1], self.K[0, 2], self.K[1, 2]], self.D])

    def with_parameters(self, values: Float64) -> Lens:
        """The lens with other `parameters`."""
        fx, fy, cx, cy = values[:4]
        return Lens(self.width, self.height, camera_matrix(fx, fy, cx, cy), self.distortion_model, np.array(values[4:]))

    def priors(self) -> Float64:
        """[3 + D] what a lens hardly is, in sigmas: oblong pixels, off centre, strongly distorted."""
        fx, fy, cx, cy = self.parameters[:4]
        off_centre = (np.array([cx, cy]) - self._middle) / (CENTRE_SIGMA * self.width)
        oblong = np.log(max(fy / fx, LEAST_ASPECT)) / ASPECT_SIGMA
        return np.concatenate([[oblong], off_centre, self.D / self._distortion_sigmas])

    def priors_jacobian(self) -> Float64:
        """[3 + D, 4 + D] of `priors` by `parameters`."""
        fx, fy = self.parameters[:2]
        J = np.zeros((3 + len(self.D), 4 + len(self.D)))
        J[0, :2] = np.array([-1 / fx, 1 / fy]) / ASPECT_SIGMA
        J[[1, 2], [2, 3]] = 1 / (CENTRE_SIGMA * self.width)
        J[3:, 4:] = np.diag(1 / self._distortion_sigmas)
        return J

    @property
    def _distortion_sigmas(self) -> Float64:
        """[D] those of `DISTORTION_SIGMAS`: a rig file may leave out the last coefficients."""
        return np.array(DISTORTION_SIGMAS[self.distortion_model][: len(self.D)])

    @property
    def _middle(self) -> Float64:
        return (np.array([self.width, self.height]) - 1) / 2


@dataclass(frozen=True)
class Projection:
    """Where points are seen, and how that changes."""

    pixels: Float64
    """[N, 2] raw, OpenCV convention."""
    by_point: Float64
    """[N, 2, 3] by the point's place in the optical frame, pixels per metre."""
    by_lens: Float64
    """[N, 2, 4 + D] by `Lens.parameters`."""


def lens_of(camera: RigCamera) -> Lens:
    """The intrinsics of a rig's camera."""
    return Lens(camera.width, camera.height, camera.K, camera.distortion_model, camera.D)


def project(lens: Optics, points: Float64) -> Projection:
    """Where a lens sees points [N, 3] m of its optical frame.

    What lies behind it is taken to `BEHIND_M` before it, far off the image, so that solvers stay finite.
    """
    count = len(points)
    if not count:  # OpenCV gives nothing of the shape asked for
        return Projection(np.zeros((0, 2)), np.zeros((0, 2, 3)), np.zeros((0, 2, 4 + len(lens.D))))
    before = np.concatenate([points[:, :2], np.maximum(points[:, 2:], BEHIND_M)], axis=1)[:, None]
    if lens.distortion_model == "equidistant":
        pixels, J = cv2.fisheye.projectPoints(before, NO_TURN, NO_TURN, lens.K, lens.D)
        J = np.asarray(J, dtype=np.float64).reshape(count, 2, -1)
        # Order of the columns: f (2), c (2), k (4), rotation, translation, skew.
        by_lens, by_point = J[..., :8], J[..., 11:14]
    else:
        pixels, J = cv2.projectPoints(before, NO_TURN, NO_TURN, lens.K, lens.D)
        J = np.asarray(J, dtype=np.float64).reshape(count, 2, -1)
        by_lens, by_point = J[..., 6 : 10 + len(lens.D)], J[..., 3:6]
    return Projection(np.asarray(pixels, np.float64).reshape(-1, 2), by_point, by_lens)


def in_view(lens: Optics, points: Float64) -> Bool:
    """[N] which points [N, 3] m of the optical frame are in a lens's image.

    Far outside its field of view a distortion's polynomial turns back, and what it puts into the image is not there.
    """
    pixels = project(lens, points).pixels
    inside = (
        (points[:, 2] > BEHIND_M) & (pixels > -0.5).all(1) & (pixels < (lens.width - 0.5, lens.height - 0.5)).all(1)
    )
    rays = np.zeros((len(points), 2))
    rays[inside] = pixel_rays(lens, pixels[inside])
    off = np.abs(rays * points[:, 2:] - points[:, :2]).max(axis=1, initial=0)
    return np.asarray(inside & (off <= SAME_RAY * points[:, 2]))


def pixel_rays(lens: Optics, pixels: Float64) -> Float64:
    """Rays (x/z, y/z) [N, 2] in the optical frame of raw pixels [N, 2] (OpenCV convention); undoes `distort`.

    Where a distortion's polynomial cannot be undone, as in the corners of some wide lenses, they are others, or NaN.
    """
    if not len(pixels):
        return np.zeros((0, 2))
    shaped = np.ascontiguousarray(pixels, dtype=np.float64)[:, None]
    if lens.distortion_model == "equidistant":
        rays = cv2.fisheye.undistortPoints(shaped, lens.K, lens.D, criteria=INVERSION_STOP)
    else:
        rays = cv2.undistortPointsIter(shaped, lens.K, lens.D, np.eye(3), np.eye(3), INVERSION_STOP)
    return np.asarray(rays, dtype=np.float64).reshape(-1, 2)


def raw_pixels(camera: Optics, points: Float64) -> Float64:
    """Raw pixels [N, 2] (OpenCV convention) of points [N, 3] m in the optical frame; far off the image behind it."""
    if not len(points):
        return np.zeros((0, 2))
    return distort(camera, points[:, :2] / np.maximum(points[:, 2:], BEHIND_M))


def camera_matrix(fx: float, fy: float, cx: float, cy: float) -> Float64:
    """`K` [3, 3], pixels."""
    return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def homogeneous(rays: Float64) -> Float64:
    """[N, 3] the directions, of depth 1, of rays (x/z, y/z) [N, 2]."""
    return np.concatenate([rays, np.ones((len(rays), 1))], axis=1)
