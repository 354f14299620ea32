"""Features on a moving arm: each is a fixed point of a link, which the joints say how it moves.

Where a feature is on its link is not known, and where it is seen at one time tells nothing of the clock. But as the arm
speeds up, slows down and turns back, its track fits its link's motion at the right time only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import inverse_pose
from twin_node.rig.calibrate.arm_motion import Film, JointCourse
from twin_node.rig.calibrate.arm_surface import arm_surface
from twin_node.rig.calibrate.lenses import homogeneous
from twin_node.robot import ArmModel
from twin_node.scene import Bool, Float64, UInt8

RESTART = 6
"""Images after which new features are sought."""
LENGTH = 40
"""Images that a feature is followed through: more than a second, in which an arm at work changes its speed."""
LEAST_LENGTH = 8
"""Images below which a track has too little change of speed to tell anything."""
MOST_FEATURES = 80
"""Features sought at a time, per image."""
WINDOW_PX = 11
"""Side of the window that is followed, pixels: what a link shows of itself at the working width."""
RETURN_PX = 0.3
"""A feature that, followed back, ends further off than this has been lost."""
ALONG, AROUND = 12, 16
"""Points on each capsule that links are told apart by."""
FACING = -0.5
"""Cosine between a surface's normal and the ray that sees it above which features slide along the outline."""
NEAR_PX = 4.0
"""Distance from a point of the arm's surface within which a feature is on it."""
MOVES_PX = 2.0
"""Tracks that by the joints should move less than this tell nothing."""
SURFACE_SIGMA_M = 0.03
"""1 sigma of a feature's place on its link: capsules are that far from the true surface."""
NOISE_PX = 0.15
"""1 sigma of a followed feature at first; then as measured."""
ROBUST_SIGMAS = 2.0
"""Errors beyond so many sigma count linearly."""
OUTLIER = 1.5
"""Tracks whose error is so many times the median track's slid along an edge, or are on something else than their link:
on simulated cells the half that fits best tells the clock to 0.2 ms, all of them to 2 ms."""
ROUNDS, STEPS = 3, 5
"""Times that outliers are left out, and Newton's steps each."""
DIFFERENCE_S = 1e-3
"""Step of numerical velocities of links."""
OFFSET_SIGMA_S, RATE_SIGMA = 0.05, 100e-6
"""1 sigma of the offset about that given, and of the rate: crystals are sold as good to 20 to 100 ppm."""
LEAST_TRACKS = 12
"""Tracks below which nothing is told."""


@dataclass(frozen=True)
class Tracks:
    """Features followed in a film, N of them through at most L images."""

    links: NDArray[np.int64]
    """[N] the link that carries each."""
    points: Float64
    """[N, 3] where on it, about, m."""
    times: Float64
    """[N, L] s, by the camera's clock, from the course's beginning."""
    pixels: Float64
    """[N, L, 2] as `Camera` counts them."""
    seen: Bool
    """[N, L]."""

    def chosen(self, rows: Bool) -> Tracks:
        """Those under a mask [N]."""
        return Tracks(self.links[rows], self.points[rows], self.times[rows], self.pixels[rows], self.seen[rows])


@dataclass(frozen=True)
class ArmClock:
    """A camera's clock against the arm's."""

    offset_s: float
    """To add to the camera's stamps, at `reference_s` from the course's beginning."""
    rate: float
    """How fast that grows."""
    covariance: Float64
    """[2, 2] of both."""
    reference_s: float
    tracks: int
    """Features that told it."""
    noise_px: float
    """1 sigma of a feature about its link's motion."""


def time_by_features(course: JointCourse, film: Film, offset_s: float) -> ArmClock | None:
    """The clock of a film's camera, from an offset right to some tens of ms; None where too little can be followed."""
    tracks = follow(course, film, offset_s)
    for _ in range(ROUNDS):
        if len(tracks.links) < LEAST_TRACKS:
            return None
        fit = _Fit(course, film, tracks, offset_s)
        clock = fit.solve()
        kept = fit.track_errors < OUTLIER * np.median(fit.track_errors)
        tracks = replace(tracks, points=fit.points).chosen(kept)
        offset_s = clock.offset_s
    return clock


def follow(course: JointCourse, film: Film, offset_s: float) -> Tracks:
    """Features found on the arm, where it is by its joints, and followed from image to image."""
    times = (film.stamps - course.start) / 1e9
    surface = _Surface(course.arm)
    parts = []
    for first in range(0, len(times) - LEAST_LENGTH, RESTART):
        last = min(first + LENGTH, len(times))
        if times[first] + offset_s < 0 or times[first] + offset_s > course.end_s:
            continue
        found = surface.features(film, first, course.links(np.array(times[first] + offset_s)))
        if len(found.links):
            pixels, seen = _followed(film.grey[first:last], found.pixels)
            own = np.broadcast_to(times[first:last], seen.shape)
            parts.append(_padded(Tracks(found.links, found.points, own, pixels, seen)))
    return _told(course, film, _joined(parts), offset_s)


@dataclass(frozen=True)
class _Features:
    links: NDArray[np.int64]
    points: Float64
    pixels: Float64


class _Surface:
    """The arm's surface, and the features on it."""

    def __init__(self, arm: ArmModel) -> None:
        self._surface = arm_surface(arm.capsules, ALONG, AROUND)

    def features(self, film: Film, image: int, links: Float64) -> _Features:
        """Corners in an image that lie on the arm, whose links are at [J + 1, 4, 4]."""
        camera, poses = film.camera, links[self._surface.links]
        placed = np.einsum("nij,nj->ni", poses[:, :3, :3], self._surface.points) + poses[:, :3, 3]
        rays = placed - camera.T_base_cam[:3, 3]
        facing = (rays * np.einsum("nij,nj->ni", poses[:, :3, :3], self._surface.normals)).sum(1)
        local = placed @ camera.viewmat[:3, :3].T + camera.viewmat[:3, 3]
        shown = (facing < FACING * np.linalg.norm(rays, axis=1)) & (local[:, 2] > 0.05)
        if not shown.any():
            return _Features(np.zeros(0, np.int64), np.zeros((0, 3)), np.zeros((0, 2)))
        pixels = local[shown, :2] / local[shown, 2:] * camera.K[[0, 1], [0, 1]] + camera.K[:2, 2]
        mask: UInt8 = np.zeros(film.grey.shape[1:], np.uint8)
        for pixel in np.rint(pixels - 0.5).astype(int).tolist():
            cv2.circle(mask, pixel, round(NEAR_PX) - 1, 255, -1)
        corners = cv2.goodFeaturesToTrack(film.grey[image], MOST_FEATURES, 0.02, 5, mask=mask, blockSize=5)
        at = np.zeros((0, 2)) if corners is None else np.asarray(corners, np.float64).reshape(-1, 2) + 0.5
        distances = np.linalg.norm(at[:, None] - pixels[None], axis=2)
        depths = np.where(distances < NEAR_PX, local[shown, 2], np.inf)
        near = np.isfinite(depths).any(1)
        nearest = depths[near].argmin(1)
        own, depth = self._surface.links[shown][nearest], local[shown, 2][nearest]
        seen = homogeneous((at[near] - camera.K[:2, 2]) / camera.K[[0, 1], [0, 1]])
        base = (seen * depth[:, None]) @ camera.T_base_cam[:3, :3].T + camera.T_base_cam[:3, 3]
        back = inverse_pose(links)[own]
        return _Features(own, np.einsum("nij,nj->ni", back[:, :3, :3], base) + back[:, :3, 3], at[near])


def _followed(grey: UInt8, start: Float64) -> tuple[Float64, Bool]:
    """Pixels [N, L, 2] of features [N, 2] through L images, and [N, L] whether they were still seen."""
    options = {"winSize": (WINDOW_PX, WINDOW_PX), "maxLevel": 2}
    here = np.ascontiguousarray(start[:, None] - 0.5, np.float32)
    pixels, seen = [start], [np.ones(len(start), dtype=bool)]
    for before, after in pairwise(grey):
        there, found, _ = cv2.calcOpticalFlowPyrLK(before, after, here, None, **options)  # type: ignore[call-overload]
        back, again, _ = cv2.calcOpticalFlowPyrLK(after, before, there, None, **options)  # type: ignore[call-overload]
        whole = (found.ravel() > 0) & (again.ravel() > 0) & (np.linalg.norm(back - here, axis=2).ravel() < RETURN_PX)
        seen.append(seen[-1] & whole)
        pixels.append(np.asarray(there, np.float64).reshape(-1, 2) + 0.5)
        here = there
    return np.stack(pixels, axis=1), np.stack(seen, axis=1)


def _padded(tracks: Tracks) -> Tracks:
    missing = LENGTH - tracks.times.shape[1]
    wide = ((0, 0), (0, missing))
    return replace(
        tracks,
        times=np.pad(tracks.times, wide, mode="edge"),
        pixels=np.pad(tracks.pixels, (*wide, (0, 0)), mode="edge"),
        seen=np.pad(tracks.seen, wide),
    )


def _joined(parts: Sequence[Tracks]) -> Tracks:
    if not parts:
        none = np.zeros((0, LENGTH))
        return Tracks(np.zeros(0, np.int64), np.zeros((0, 3)), none, np.zeros((0, LENGTH, 2)), none > 0)
    return Tracks(*(np.concatenate([getattr(part, name) for part in parts]) for name in Tracks.__annotations__))


def _told(course: JointCourse, film: Film, tracks: Tracks, offset_s: float) -> Tracks:
    """The tracks that are long enough, within the joints' recording, and on links that move."""
    at = tracks.times + offset_s
    tracks = replace(tracks, seen=tracks.seen & (at > 0) & (at < course.end_s))
    if not len(tracks.links):
        return tracks
    view = _Fit(course, film, tracks, offset_s).look(tracks.points, offset_s, 0.0)
    spread = np.where(tracks.seen[..., None], view.pixels, np.nan)
    with np.errstate(invalid="ignore"):
        moves = np.nanmax(spread, axis=1) - np.nanmin(spread, axis=1)
    return tracks.chosen((tracks.seen.sum(1) >= LEAST_LENGTH) & (np.linalg.norm(moves, axis=1) > MOVES_PX))


@dataclass(frozen=True)
class _Look:
    pixels: Float64
    """[N, L, 2]."""
    by_point: Float64
    """[N, L, 2, 3] by the point's place on its link."""
    by_time: Float64
    """[N, L, 2] pixels per second."""


class _Fit:
    """Places of all features on their links, and the clock, by robust least squares."""

    def __init__(self, course: JointCourse, film: Film, tracks: Tracks, offset_s: float) -> None:
        self._course, self._film, self._tracks = course, film, tracks
        self._given = offset_s
        self._reference = float(tracks.times[tracks.seen].mean()) if tracks.seen.any() else 0.0
        self.points = tracks.points
        """[N, 3] as fitted."""
        self.track_errors = np.zeros(len(tracks.links))
        """[N] root mean square, pixels."""

    def look(self, points: Float64, offset_s: float, rate: float) -> _Look:
        """Where the features are to be seen."""
        tracks, camera = self._tracks, self._film.camera
        times = tracks.times + offset_s + rate * (tracks.times - self._reference)
        grid, place = np.unique(times, return_inverse=True)
        place = place.reshape(times.shape)
        poses = self._course.links(grid)
        later = self._course.links(grid + DIFFERENCE_S)
        T = camera.viewmat @ poses[place, tracks.links[:, None]]
        T_later = camera.viewmat @ later[place, tracks.links[:, None]]
        local = np.einsum("nlij,nj->nli", T[..., :3, :3], points) + T[..., :3, 3]
        moved = np.einsum("nlij,nj->nli", T_later[..., :3, :3], points) + T_later[..., :3, 3]
        depth = np.maximum(local[..., 2:], 1e-3)
        focal = camera.K[[0, 1], [0, 1]]
        by_local = np.zeros((*local.shape[:2], 2, 3))
        by_local[..., 0, 0], by_local[..., 1, 1] = focal[0] / depth[..., 0], focal[1] / depth[..., 0]
        by_local[..., 2] = -focal * local[..., :2] / depth**2
        by_time = np.einsum("nlij,nlj->nli", by_local, (moved - local) / DIFFERENCE_S)
        return _Look(local[..., :2] / depth * focal + camera.K[:2, 2], by_local @ T[..., :3, :3], by_time)

    def solve(self) -> ArmClock:
        """The best clock; sets `points` and `track_errors`."""
        tracks, noise, clock = self._tracks, NOISE_PX, np.array([self._given, 0.0])
        since = (tracks.times - self._reference)[..., None]
        prior, excess = np.diag([OFFSET_SIGMA_S**-2, RATE_SIGMA**-2]), 1.0
        for _ in range(STEPS):
            look = self.look(self.points, *clock)
            off = np.where(tracks.seen[..., None], tracks.pixels - look.pixels, 0.0)
            lengths = np.linalg.norm(off, axis=2) / noise
            weights = np.where(tracks.seen, 1 / np.sqrt(1 + (lengths / ROBUST_SIGMAS) ** 2), 0.0) / noise**2
            by_clock = np.stack([look.by_time, look.by_time * since], axis=-1)
            weighted = look.by_point * weights[..., None, None]
            A = np.einsum("nlij,nlik->njk", weighted, look.by_point) + np.eye(3) / SURFACE_SIGMA_M**2
            B = np.einsum("nlij,nlik->njk", weighted, by_clock)
            a = np.einsum("nlij,nli->nj", weighted, off) - (self.points - tracks.points) / SURFACE_SIGMA_M**2
            C = np.einsum("nlij,nlik,nl->njk", by_clock, by_clock, weights)
            c = np.einsum("nlij,nli,nl->nj", by_clock, off, weights)
            reach = np.linalg.solve(A, np.concatenate([B, a[..., None]], axis=2))
            reduced = c - np.einsum("njk,nj->nk", B, reach[..., 2])
            data = (C - B.swapaxes(1, 2) @ reach[..., :2]).sum(0)
            # Errors of tracks go together, so that they disagree by more than their noise says.
            spread = self._spread(reduced)
            excess = max(float(spread[0, 0] / max(data[0, 0], 1e-12)), 1.0)
            schur = data + excess * prior
            step = np.linalg.solve(schur, reduced.sum(0) - excess * prior @ (clock - [self._given, 0.0]))
            clock = clock + step
            self.points = self.points + reach[..., 2] - reach[..., :2] @ step
            noise = max(1.4826 * float(np.median(np.abs(off[tracks.seen]))), 0.01)
        counts = np.maximum(tracks.seen.sum(1), 1)
        self.track_errors = np.sqrt((off**2).sum((1, 2)) / counts)
        back = np.linalg.inv(schur)
        covariance = back @ (spread + excess**2 * prior) @ back
        return ArmClock(clock[0], clock[1], covariance, self._reference, len(tracks.links), noise)

    def _spread(self, slopes: Float64) -> Float64:
        """[2, 2] covariance of the sum of the tracks' slopes [N, 2].

        Tracks that are followed at the same time are of the same features, and edges, and err together by as much of
        their time as they share (Bartlett's weights: Newey and West, Econometrica 1987).
        """
        times = self._tracks.times
        return spread_of(times[:, 0], slopes, float(np.ptp(times, axis=1).max()))


def spread_of(starts: Float64, slopes: Float64, length: float) -> Float64:
    """[D, D] covariance of the sum of slopes [N, D] that begin at `starts` [N] and err together while they last, all
    for a `length`; in a time that grows with N, for a recording has thousands."""
    order = np.argsort(starts, kind="stable")
    starts, slopes = starts[order] - starts[order[0]], slopes[order]
    first = np.searchsorted(starts, starts - length, side="right")
    sums, moments = (
        np.concatenate([np.zeros((1, slopes.shape[1])), np.cumsum(of, axis=0)])
        for of in (slopes, starts[:, None] * slopes)
    )
    last = np.arange(1, len(starts) + 1)
    before = (1 - starts[:, None] / length) * (sums[last] - sums[first]) + (moments[last] - moments[first]) / length
    half = slopes.T @ before  # of every pair once, and of each slope with itself
    return np.asarray(half + half.T - slopes.T @ slopes)
