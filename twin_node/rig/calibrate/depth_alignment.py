"""Cameras that measure depth, moved until the surfaces that they see in common are one, and look the same.

Iterative closest points of all pairs at once, from point to plane, found by projection (Blais and Levine, "Registering
multiview range data to create 3D computer objects", PAMI 1995), with the surfaces' own pattern beside their shape
(Park, Zhou and Koltun, "Colored point cloud registration revisited", ICCV 2017): a table's shape says nothing of shifts
along it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations, permutations

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import cross, inverse_pose, transform
from twin_node.rig.calibrate.islands import islands
from twin_node.rig.calibrate.lenses import lens_of, pixel_rays, project, raw_pixels
from twin_node.rig.calibrate.rotations import cross_matrix, moved
from twin_node.rig.errors import RigError
from twin_node.scene import Bool, Float32, Float64, RigCamera, UInt8

GATES_M = (0.15, 0.12, 0.10, 0.06, 0.04, 0.03, 0.02)
"""Distances within which surfaces are taken for the same, from the first rounds to the last."""
BLURS_PX = (16.0, 10.0, 6.0, 4.0, 2.5, 1.5, 1.0)
"""Blurs of the patterns that are compared meanwhile, 1 sigma, pixels: coarse ones lead to where fine ones can tell."""
SURROUNDINGS = 4.0
"""Contrast is what is left without a pattern blurred so many times wider: light is not alike from two sides."""
CONTRAST_SIGMA = 0.02
"""Least 1 sigma of log contrast: 8-bit levels."""
STARTS, START_SHARE = 6, 0.5
"""Descents, the first from the rig given, the others from about it (share of a sigma): patterns that repeat make false
minima; what fits best in the end is taken."""
ROUNDS = 6
"""Newton's steps at each level."""
MOST_STRAIN = 3.0
"""A rig that any number of is so many sigma from the one given is not believed: a thing was taken for another."""
SAMPLES = 4000
"""Points of each camera that are laid onto the surfaces of every other."""
STEP = 0.03
"""Change of depth to the next pixel, as a share of it, beyond which there is an edge and no surface."""
NORMAL_SHARE = 1 / 60
"""How far about a pixel a plane is fitted for its normal, as a share of the image's width: between neighbours noise of
the depth is a slope, and slopes seem to tell of motions along a surface."""
SLANT = 0.2
"""Cosine between a surface's normal and the ray that sees it below which its depth is not to be had."""
ALIKE = 0.85
"""Cosine between two cameras' normals from which they may be of one surface."""
SURFACE_SIGMA_M = 0.002
"""Least 1 sigma of a median depth: what is left of lens and matcher when noise is averaged out."""
ROBUST_SIGMAS = 2.0
"""Distances beyond so many sigma count linearly: people, and what stands before what."""
TOGETHER = 50.0
"""Neighbouring samples of a surface err together: so many count as one."""
MOST_OPEN_M = 0.01
"""1 sigma of how two cameras place what they share against each other, beyond which the rig given would decide."""
AROUND_PX = np.array([[0.0, 0.0], [0.5, 0.0], [-0.5, 0.0], [0.0, 0.5], [0.0, -0.5]])
"""[5, 2] where a pattern is read about a pixel: there, and to both sides for its slopes."""
LEAST_SHARED = 100
"""Samples that two cameras must share to be held against each other."""
THROUGH_M, THROUGH_SHARE = 0.05, 0.03
"""How far before what a camera measures, and as a share of that, a sample of another stands in its free sight."""
MOST_THROUGH = 0.05
"""Share of samples in another camera's free sight: 0.001 where a rig is right, a tenth where floors lie on floors but
all that stands on them was passed over."""


@dataclass(frozen=True)
class Surface:
    """What one camera measures of what stands still."""

    points: Float64
    """[H, W, 3] in the optical frame, m."""
    normals: Float64
    """[H, W, 3] towards the camera."""
    known: Bool
    """[H, W]."""
    patterns: tuple[Float32, ...]
    """Per `BLURS_PX`: [H, W] log contrast."""


@dataclass(frozen=True)
class SurfacePair:
    """How two cameras' surfaces lie to each other."""

    a: int
    b: int
    samples: int
    before_m: float
    """Median distance from surface to surface before the alignment, of what lay within the widest gate."""
    after_m: float
    open_m: float
    """1 sigma of how one places what they share against the other, along what surfaces tell least, m. Gaps do not show
    it: a surface that slides along itself leaves none."""


@dataclass(frozen=True)
class DepthAlignment:
    """Poses that make surfaces agree."""

    T_base_cam: Float64
    """[C, 4, 4]."""
    covariance: Float64
    """[6 C, 6 C] of turns about the base's axes (rad) and moves along them (m), camera by camera."""
    pairs: tuple[SurfacePair, ...]


def surface_of(camera: RigCamera, rgb: UInt8, depth: Float32, still: Bool) -> Surface:
    """The surface that an image [H, W, 3] and its depth [H, W] (m, 0 where unknown) show where they stand still."""
    v, u = np.mgrid[: camera.height, : camera.width].astype(np.float64)
    rays = pixel_rays(camera, np.stack([u.ravel(), v.ravel()], axis=1)).reshape(*depth.shape, 2)
    points = np.concatenate([rays * depth[..., None], depth[..., None].astype(np.float64)], axis=-1)
    across, down = np.zeros_like(depth), np.zeros_like(depth)
    across[:, 1:-1], down[1:-1] = depth[:, 2:] - depth[:, :-2], depth[2:] - depth[:-2]
    known = still & (depth > 0) & (np.maximum(np.abs(across), np.abs(down)) < 2 * STEP * depth)
    reach = max(round(NORMAL_SHARE * camera.width), 1)
    known = cv2.erode(known.astype(np.uint8), np.ones((2 * reach + 1,) * 2), borderValue=0) > 0
    ramp, level = np.arange(-reach, reach + 1.0), np.ones(2 * reach + 1)
    normals = cross(cv2.sepFilter2D(points, -1, level, ramp), cv2.sepFilter2D(points, -1, ramp, level))
    normals /= np.maximum(np.linalg.norm(normals, axis=-1, keepdims=True), 1e-12)
    facing = -(normals * points).sum(-1) > SLANT * np.linalg.norm(points, axis=-1)
    light = np.log(cv2.cvtColor(rgb, cv2.COLOR_RGB2GRAY).astype(np.float32) + 8)
    patterns = tuple(
        np.asarray(
            cv2.GaussianBlur(light, (0, 0), blur) - cv2.GaussianBlur(light, (0, 0), SURROUNDINGS * blur), np.float32
        )
        for blur in BLURS_PX
    )
    return Surface(points, normals, known & facing, patterns)


def align(cameras: Sequence[RigCamera], surfaces: Sequence[Surface], turn: float, move_m: float) -> DepthAlignment:
    """Poses nearest to those given (1 sigma: `turn` rad, `move_m`) whose surfaces agree.

    Raises `RigError` naming the cameras where surfaces leave a motion open (`MOST_OPEN_M`), or a camera shares none.
    """
    samples = [_Samples.of(surface) for surface in surfaces]
    weights = np.tile([turn**-2] * 3 + [move_m**-2] * 3, len(cameras))
    rng = np.random.default_rng(0)
    starts = rng.normal(0, START_SHARE, (STARTS, 6 * len(cameras))) / np.sqrt(weights)
    starts[0] = 0
    found = [_descended(cameras, surfaces, samples, weights, start) for start in starts]
    best = min(found, key=lambda result: result.misfit)
    covariance = np.asarray(np.linalg.inv(best.information + np.diag(weights)), np.float64)
    pairs = _pairs(cameras, surfaces, samples, best.poses, covariance)
    _check_told(cameras, pairs)
    _check_sight(cameras, surfaces, samples, best.poses)
    strain = float(np.abs(best.changes * np.sqrt(weights)).max())
    if strain > MOST_STRAIN:
        raise RigError(
            f"refine: expected a rig near the one given, at most {MOST_STRAIN:g} sigma away, found one at "
            f"{strain:.1f}: are the poses given right to a degree or two? Else use a board"
        )
    return DepthAlignment(best.poses, covariance, pairs)


@dataclass(frozen=True)
class _Descent:
    poses: Float64
    changes: Float64
    """[6 C] from the poses given, as `moved` takes them."""
    information: Float64
    """[6 C, 6 C] of the changes."""
    misfit: float
    """Median distances and differences of patterns, in their least sigmas, mean of all pairs."""


def _descended(
    cameras: Sequence[RigCamera],
    surfaces: Sequence[Surface],
    samples: Sequence[_Samples],
    weights: Float64,
    start: Float64,
) -> _Descent:
    """The nearest minimum from changes [6 C] of the poses given, from coarse patterns to fine ones."""
    given = np.stack([camera.T_base_cam for camera in cameras])
    changes, poses = start, moved(given, start.reshape(-1, 6))
    for level in range(len(GATES_M)):
        for _ in range(ROUNDS):
            matches = [
                _match(cameras, surfaces, samples, poses, level, pair) for pair in permutations(range(len(cameras)), 2)
            ]
            H, g = _system(matches, poses)
            step = np.linalg.solve(H + np.diag(weights), g - weights * changes)
            changes = changes + step
            poses = moved(given, changes.reshape(-1, 6))
    off = [
        float(np.median(np.abs(m.gaps))) / SURFACE_SIGMA_M + float(np.median(np.abs(m.contrasts))) / CONTRAST_SIGMA
        for m in matches
        if len(m.gaps)
    ]
    return _Descent(poses, changes, H, float(np.mean(off)) if off else np.inf)


@dataclass(frozen=True)
class _Match:
    """Samples of camera a on surfaces of camera b."""

    a: int
    b: int
    places: Float64
    """[n, 3] of the samples in the base, m."""
    normals: Float64
    """[n, 3] of b's surface in the base."""
    gaps: Float64
    """[n] m, from b's surface to the sample, along the normal."""
    slopes: Float64
    """[n, 3] of b's pattern by the sample's place in the base, 1/m."""
    contrasts: Float64
    """[n] b's pattern less a's."""


@dataclass(frozen=True)
class _InSight:
    """Points before which, or behind which, a camera measures a surface."""

    rows: NDArray[np.intp]
    """[n] of the points."""
    there: NDArray[np.int64]
    """[n] the pixel, counted along the rows of the image, that each falls on."""


@dataclass(frozen=True)
class _Samples:
    """Points of one camera's surface that are laid onto the others'."""

    points: Float64
    """[n, 3] in the optical frame, m."""
    normals: Float64
    """[n, 3]."""
    patterns: tuple[Float32, ...]
    """Per `BLURS_PX`: [n]."""

    @classmethod
    def of(cls, surface: Surface) -> _Samples:
        """Evenly picked of what is known."""
        known = np.flatnonzero(surface.known)
        chosen = known[:: max(len(known) // SAMPLES, 1)]
        points, normals = (field.reshape(-1, 3)[chosen] for field in (surface.points, surface.normals))
        return cls(points, normals, tuple(pattern.ravel()[chosen] for pattern in surface.patterns))


def _match(
    cameras: Sequence[RigCamera],
    surfaces: Sequence[Surface],
    samples: Sequence[_Samples],
    poses: Float64,
    level: int,
    pair: tuple[int, int],
) -> _Match:
    a, b = pair
    own, other, camera = samples[a], surfaces[b], cameras[b]
    T_b_a = inverse_pose(poses[b]) @ poses[a]
    local = transform(T_b_a, own.points)
    sight = _in_sight(camera, other, local)
    rows, there = sight.rows, sight.there
    normals, surface = (field.reshape(-1, 3).take(there, axis=0) for field in (other.normals, other.points))
    gaps = np.einsum("ni,ni->n", local.take(rows, axis=0) - surface, normals)
    alike = np.einsum("ni,ni->n", own.normals.take(rows, axis=0) @ T_b_a[:3, :3].T, normals) > ALIKE
    kept = alike & (np.abs(gaps) < GATES_M[level])
    rows, R = rows[kept], poses[b, :3, :3]
    projection = project(lens_of(camera), local.take(rows, axis=0))
    seen = _sampled(other.patterns[level], projection.pixels[:, None] + AROUND_PX)
    by_pixel = np.stack([seen[:, 1] - seen[:, 2], seen[:, 3] - seen[:, 4]], axis=1)
    slopes = np.einsum("ni,nij->nj", by_pixel, projection.by_point)
    contrasts = seen[:, 0] - own.patterns[level][rows]
    places = transform(poses[a], own.points.take(rows, axis=0))
    return _Match(a, b, places, normals[kept] @ R.T, gaps[kept], slopes @ R.T, contrasts)


def _in_sight(camera: RigCamera, surface: Surface, local: Float64) -> _InSight:
    """Which of the points [N, 3] of a camera's optical frame fall where it knows a surface, and where that is."""
    u, v = np.rint(raw_pixels(camera, local)).T
    inside = (local[:, 2] > 0) & (u >= 1) & (u < camera.width - 1) & (v >= 1) & (v < camera.height - 1)
    rows = np.flatnonzero(inside)
    there = (v[rows] * camera.width + u[rows]).astype(np.int64)
    known = surface.known.ravel()[there]
    return _InSight(rows[known], there[known])


def _sampled(image: Float32, pixels: Float64) -> Float64:
    """[n, k] values of an image between its pixels [n, k, 2]."""
    if not len(pixels):
        return np.zeros(pixels.shape[:2])
    at = np.ascontiguousarray(pixels, np.float32)
    return np.asarray(cv2.remap(image, at[..., 0], at[..., 1], cv2.INTER_LINEAR), np.float64)


def _system(matches: Sequence[_Match], poses: Float64) -> tuple[Float64, Float64]:
    """Information [6 C, 6 C] of the gaps about changes of the poses (as `moved` takes them), and slopes [6 C]."""
    H, g = np.zeros((6 * len(poses),) * 2), np.zeros(6 * len(poses))
    for match in matches:
        if not len(match.gaps):
            continue
        own = np.r_[6 * match.a : 6 * match.a + 6, 6 * match.b : 6 * match.b + 6]
        by_poses = _apart(poses[match.a], poses[match.b])
        for directions, off, least in (
            (match.normals, match.gaps, SURFACE_SIGMA_M),
            (match.slopes, match.contrasts, CONTRAST_SIGMA),
        ):
            sigma = max(1.4826 * float(np.median(np.abs(off))), least)
            weights = 1 / np.sqrt(1 + (off / sigma / ROBUST_SIGMAS) ** 2) / sigma**2 / TOGETHER
            J = np.hstack([cross(match.places, directions), directions])
            weighted = J * weights[:, None]
            H[np.ix_(own, own)] += by_poses.T @ (J.T @ weighted) @ by_poses
            g[own] -= by_poses.T @ (off @ weighted)
    return H, g


def _apart(a: Float64, b: Float64) -> Float64:
    """[6, 12] motion between surfaces, a turn about the base's origin and a shift, by changes of poses [4, 4]."""
    one, none = np.eye(3), np.zeros((3, 3))
    return np.block([[one, none, -one, none], [cross_matrix(a[:3, 3]), one, -cross_matrix(b[:3, 3]), -one]])


def _pairs(
    cameras: Sequence[RigCamera],
    surfaces: Sequence[Surface],
    samples: Sequence[_Samples],
    poses: Float64,
    covariance: Float64,
) -> tuple[SurfacePair, ...]:
    given = np.stack([camera.T_base_cam for camera in cameras])
    out = []
    for a, b in combinations(range(len(cameras)), 2):
        before = _match(cameras, surfaces, samples, given, 0, (a, b))
        after = _match(cameras, surfaces, samples, poses, len(GATES_M) - 1, (a, b))
        if min(len(before.gaps), len(after.gaps)) >= LEAST_SHARED:
            before_m, after_m = (float(np.median(np.abs(match.gaps))) for match in (before, after))
            out.append(SurfacePair(a, b, len(after.gaps), before_m, after_m, _open_m(after, poses, covariance)))
    return tuple(out)


def _open_m(match: _Match, poses: Float64, covariance: Float64) -> float:
    """1 sigma, m, that a covariance [6 C, 6 C] of the changes of poses leaves between two cameras where they match."""
    own = np.r_[6 * match.a : 6 * match.a + 6, 6 * match.b : 6 * match.b + 6]
    by_poses = _apart(poses[match.a], poses[match.b])
    motion = by_poses @ covariance[np.ix_(own, own)] @ by_poses.T
    by_motion = np.concatenate([-cross_matrix(match.places), np.broadcast_to(np.eye(3), (len(match.places), 3, 3))], 2)
    return float(np.sqrt(np.linalg.eigvalsh((by_motion @ motion @ by_motion.transpose(0, 2, 1)).mean(0))[-1]))


def _check_told(cameras: Sequence[RigCamera], pairs: Sequence[SurfacePair]) -> None:
    """Every relative motion must be told by surfaces, not by the rig given."""
    _, *apart = islands(len(cameras), [(pair.a, pair.b) for pair in pairs])
    if apart:
        raise RigError(
            f"refine: camera {cameras[apart[0][0]].name}: expected surfaces that another camera sees too, found none "
            f"within {100 * GATES_M[0]:.0f} cm; are the poses given right to a degree or two? Else use a board"
        )
    worst = max(pairs, key=lambda pair: pair.open_m)
    if worst.open_m > MOST_OPEN_M:
        raise RigError(
            f"refine: cameras {cameras[worst.a].name} and {cameras[worst.b].name}: expected surfaces that tell all "
            f"their motions to {1000 * MOST_OPEN_M:.0f} mm, found one that they leave open by "
            f"{1000 * worst.open_m:.0f} mm: put something with three different faces where both see it, or use a board"
        )


def _check_sight(
    cameras: Sequence[RigCamera], surfaces: Sequence[Surface], samples: Sequence[_Samples], poses: Float64
) -> None:
    """What one camera measures must not stand where another looks through: gaps beyond the gates count for no fit."""
    for a, b in permutations(range(len(cameras)), 2):
        local = transform(inverse_pose(poses[b]) @ poses[a], samples[a].points)
        sight = _in_sight(cameras[b], surfaces[b], local)
        depths = surfaces[b].points[..., 2].ravel()[sight.there]
        through = local[sight.rows, 2] < depths * (1 - THROUGH_SHARE) - THROUGH_M
        if len(through) >= LEAST_SHARED and (share := float(through.mean())) > MOST_THROUGH:
            raise RigError(
                f"refine: cameras {cameras[a].name} and {cameras[b].name}: expected surfaces that fit together, found "
                f"{100 * share:.0f} % of what the first measures in the free sight of the second: are the poses given "
                "right to a degree or two, and is the board's size? Else use a board"
            )
