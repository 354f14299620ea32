"""A rig made better by an ordinary recording: what stands still must fit together in all cameras."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from twin_node.rig.calibrate.birds_eye import ground_of, lay_flat
from twin_node.rig.calibrate.depth_alignment import SurfacePair, align, surface_of
from twin_node.rig.calibrate.ground_matches import agreed_map, measured
from twin_node.rig.calibrate.islands import islands
from twin_node.rig.calibrate.match_adjustment import Adjusted, adjust_matches
from twin_node.rig.calibrate.matches import Matches, epipolar_px, feature_matches, plane_gap_m
from twin_node.rig.calibrate.refine_doubt import Doubt, doubt_of, witnesses_of
from twin_node.rig.calibrate.stills import Still
from twin_node.rig.errors import RigError
from twin_node.rig.undistort import Undistorter
from twin_node.rig.workspace import workspace_of
from twin_node.scene import Float64, Rig, RigCamera

MOST_MATCHES = 150
"""Matches on the plane that a pair is fitted to: neighbours err together, more of them only take time."""
LEAST_JUDGES = 8
"""Matches below which a pair of cameras is given no figures."""
LEAST_SIGMA_M = 0.001
"""No rig is stated to be better than this: what medians of video leave."""
DISTINCT = 1.08
"""How many times the misfit of the best map of the ground its rival's must be: below it the pattern repeats."""
LEAST_APART_M = 0.001
"""Cameras nearer to each other are said to be in one place."""
LEAST_MATCHES = 24
"""Matches that a pair of cameras must share to count as connected."""
TURN_DEG, MOVE_M = 2.0, 0.03
"""1 sigma of the turns and places of cameras that measure depth: enough of their surroundings is seen to tell more than
the few points that others share."""
MOST_STRAIN = 3.0
"""A fit that changes any number by so many of its sigmas is not believed: a thing was taken for another."""
MOST_GAP = 0.75
"""Nor one that leaves cameras so far apart on the plane, in pixels of the ground: it was no plane, or another."""
GATES_PX = (16.0, 3.0)
"""Epipolar distance up to which features are taken for matches, one per round: a better rig shows the ground better."""


@dataclass(frozen=True)
class PairFigures:
    """How two cameras agree: on the plane, on matches that the fit has not seen.

    Epipolar figures are of those and of all matches off the plane, which are too few to keep any from the fit.
    """

    a: str
    b: str
    matches: int
    epipolar_before_px: float
    """Median distance from the epipolar line."""
    epipolar_after_px: float
    plane_before_m: float | None
    """Median distance on the plane; None where the pair has no matches on it."""
    plane_after_m: float | None


@dataclass(frozen=True)
class RefineResult:
    """A refined rig and what it was judged by."""

    rig: Rig
    plane: Float64 | None
    """[4] the refined plane."""
    pairs: tuple[PairFigures, ...]
    skipped: tuple[str, ...]
    """Pairs of cameras that told nothing, and why."""
    pose_covariances: Float64
    """[C, 6, 6] of `T_base_cam`: position (m), turns about the base's axes (rad), without what moves the rig as a
    whole. What nothing told is as open as the rig given was taken to be."""
    surfaces: tuple[SurfacePair, ...] = ()
    """How cameras that measure depth agree; `pairs` is empty then."""


def refine_rig(rig: Rig, stills: Sequence[Still], plane: Float64 | None) -> RefineResult:
    """Poses, and lenses within their priors, that make what stands still agree; `plane` [4] holds much of it, or None.

    Cameras that all measure depth are aligned by their surfaces instead (`depth_alignment`).
    Half of the matches on the plane are fitted, the other half judges. Scale and place in the base are those that leave
    the given poses least changed.

    Raises `RigError` where the geometry cannot tell: it names the cameras and what was lacking.
    """
    if measured_by_depth(stills):
        return _by_depth(rig, stills)
    _check_apart(rig.cameras)
    features = feature_matches(stills)
    now = Adjusted(rig.cameras, plane)
    seen = _Seen((), (), 0.0)
    for i, gate in enumerate(GATES_PX):
        seen = _on_plane(stills, now, rig.workspace, aligned=i > 0)
        matches = [*seen.matches, *(_gated(pair, now.cameras, gate) for pair in features)]
        _check_connected(rig.cameras, matches, seen.skipped)
        now = adjust_matches(rig.cameras, plane, [_half(pair, 0) for pair in matches])
    figures = _figures(rig, plane, now, [_half(pair, 1) for pair in matches])
    _check_believable(now, figures, seen.pixel_m)
    assert now.covariance is not None  # of what was adjusted
    doubt = doubt_of(now.cameras, now.covariance, witnesses_of(now.cameras, matches))
    refined = _with_sigmas(rig, now.cameras, figures, doubt)
    return RefineResult(refined, now.plane, figures, seen.skipped, doubt.pose_covariances)


def measured_by_depth(stills: Sequence[Still]) -> bool:
    """Whether surfaces tell how the cameras stand, and no plane is looked at."""
    return all(still.depth is not None for still in stills) and len(stills) > 1


def _by_depth(rig: Rig, stills: Sequence[Still]) -> RefineResult:
    surfaces = [
        surface_of(camera, still.rgb, still.depth, still.still)
        for camera, still in zip(rig.cameras, stills, strict=True)
        if still.depth is not None
    ]
    found = align(rig.cameras, surfaces, np.radians(TURN_DEG), MOVE_M)
    cameras = []
    for i, camera in enumerate(rig.cameras):
        off = [max(pair.after_m, pair.open_m) for pair in found.pairs if i in (pair.a, pair.b)]
        cameras.append(replace(camera, T_base_cam=found.T_base_cam[i], sigma_m=max(LEAST_SIGMA_M, *off)))
    doubt = doubt_of(cameras, found.covariance, np.zeros((0, 3)))
    return RefineResult(replace(rig, cameras=tuple(cameras)), None, (), (), doubt.pose_covariances, found.pairs)


@dataclass(frozen=True)
class _Seen:
    """What was found on the plane."""

    matches: tuple[Matches, ...]
    skipped: tuple[str, ...]
    """Pairs that told nothing, and why."""
    pixel_m: float
    """Side of the ground's pixels."""


def _on_plane(
    stills: Sequence[Still],
    now: Adjusted,
    workspace: Float64 | None,
    aligned: bool,
) -> _Seen:
    """Matches on the plane of every pair that shows it.

    Where a fit has `aligned` the cameras, a pair whose pattern alone could not tell is told by the others.
    """
    if now.plane is None:
        return _Seen((), (), 0.0)
    if workspace is None:
        workspace = workspace_of([Undistorter(camera).camera for camera in now.cameras])
    ground = ground_of(now.cameras, now.plane, workspace)
    sheets = [lay_flat(replace(s, camera=c), ground) for s, c in zip(stills, now.cameras, strict=True)]
    found: list[Matches] = []
    skipped: list[str] = []
    for a, b in combinations(range(len(sheets)), 2):
        affine = np.eye(2, 3)
        if not aligned:
            agreed = agreed_map(sheets[a], sheets[b])
            if agreed is None or agreed.distinctness < DISTINCT:
                why = "share too little of the plane" if agreed is None else "see a pattern that fits in several places"
                skipped.append(f"{now.cameras[a].name} and {now.cameras[b].name} {why}")
                continue
            affine = agreed.affine
        points = measured(sheets[a], sheets[b], affine)
        pixels_a, pixels_b = ground.pixels(now.cameras[a], points.a), ground.pixels(now.cameras[b], points.b)
        if len(points.a) < LEAST_MATCHES:
            skipped.append(f"{now.cameras[a].name} and {now.cameras[b].name} share too little of the plane")
            continue
        found.append(Matches(a, b, pixels_a, pixels_b, on_plane=True))
    return _Seen(tuple(found), tuple(skipped), ground.pixel_m)


def _gated(matches: Matches, cameras: Sequence[RigCamera], gate_px: float) -> Matches:
    off = epipolar_px(cameras[matches.a], cameras[matches.b], matches.pixels_a, matches.pixels_b)
    return matches.where(np.abs(off) < gate_px)


def _half(matches: Matches, part: int) -> Matches:
    """Every second match on the plane, thinned where more do not help; of the few others all take both parts."""
    if not matches.on_plane:
        return matches
    step = 2 * max(len(matches) // (2 * MOST_MATCHES), 1)
    return matches.where(np.arange(len(matches)) % step == part)


def _check_apart(cameras: Sequence[RigCamera]) -> None:
    """Nothing is held against a camera alone, and between cameras in one place are no epipolar lines."""
    if len(cameras) < 2:
        raise RigError(
            f"refine: camera {cameras[0].name}: expected another camera to hold it against, found it alone; calibrate "
            "it with a board (`calibrate hand-eye`)"
        )
    for a, b in combinations(cameras, 2):
        if np.linalg.norm(a.T_base_cam[:3, 3] - b.T_base_cam[:3, 3]) < LEAST_APART_M:
            raise RigError(
                f"refine: cameras {a.name} and {b.name}: expected poses that are right to a degree or two, found both "
                "in one place, as where nobody knows where they stand; calibrate with a board"
            )


def _check_connected(cameras: Sequence[RigCamera], matches: Sequence[Matches], skipped: Sequence[str]) -> None:
    """Every camera must hang together with the first through pairs with enough matches."""
    shared: Counter[tuple[int, int]] = Counter()
    for pair in matches:
        shared[pair.a, pair.b] += len(pair)
    _, *apart = islands(len(cameras), [pair for pair, n in shared.items() if n >= LEAST_MATCHES])
    if apart:
        reason = f" ({'; '.join(skipped)})" if skipped else ""
        raise RigError(
            f"refine: camera {cameras[apart[0][0]].name}: expected at least {LEAST_MATCHES} points shared with "
            f"another camera, found fewer{reason}; record a scene with more texture, or calibrate with a board"
        )


def _check_believable(now: Adjusted, figures: Sequence[PairFigures], pixel_m: float) -> None:
    advice = "is much of the scene on one plane, and are the poses given right to a degree or two? Else use a board"
    if now.strain > MOST_STRAIN:
        raise RigError(
            f"refine: expected a rig near the one given, at most {MOST_STRAIN:g} sigma away, found one at "
            f"{now.strain:.2f}; {advice}"
        )
    gap = max((f.plane_after_m for f in figures if f.plane_after_m is not None), default=0.0)
    if gap > MOST_GAP * pixel_m:
        raise RigError(
            f"refine: expected cameras that agree on the plane to {1000 * MOST_GAP * pixel_m:.1f} mm, found "
            f"{1000 * gap:.1f} mm; {advice}"
        )


def _figures(rig: Rig, plane: Float64 | None, now: Adjusted, judging: Sequence[Matches]) -> tuple[PairFigures, ...]:
    out = []
    for a, b in combinations(range(len(rig.cameras)), 2):
        pairs = [pair for pair in judging if (pair.a, pair.b) == (a, b) and len(pair)]
        if sum(map(len, pairs)) < LEAST_JUDGES:
            continue
        on_plane = [pair for pair in pairs if pair.on_plane]
        out.append(
            PairFigures(
                rig.cameras[a].name,
                rig.cameras[b].name,
                sum(map(len, pairs)),
                _median_epipolar(rig.cameras, pairs),
                _median_epipolar(now.cameras, pairs),
                _median_gap(rig.cameras, plane, on_plane),
                _median_gap(now.cameras, now.plane, on_plane),
            )
        )
    return tuple(out)


def _median_epipolar(cameras: Sequence[RigCamera], pairs: Sequence[Matches]) -> float:
    off = [epipolar_px(cameras[p.a], cameras[p.b], p.pixels_a, p.pixels_b) for p in pairs]
    return float(np.median(np.abs(np.concatenate(off))))


def _median_gap(cameras: Sequence[RigCamera], plane: Float64 | None, pairs: Sequence[Matches]) -> float | None:
    if plane is None or not pairs:
        return None
    gaps = [plane_gap_m(cameras[p.a], cameras[p.b], plane, p.pixels_a, p.pixels_b) for p in pairs]
    return float(np.nanmedian(np.concatenate(gaps)))


def _with_sigmas(rig: Rig, refined: Sequence[RigCamera], figures: Sequence[PairFigures], doubt: Doubt) -> Rig:
    """The refined rig, each camera with the error that its pairs still show on the plane, or what is left open."""
    cameras = []
    for camera, open_m in zip(refined, doubt.sigmas_m.tolist(), strict=True):
        gaps = [f.plane_after_m for f in figures if camera.name in (f.a, f.b) and f.plane_after_m is not None]
        cameras.append(replace(camera, sigma_m=max(LEAST_SIGMA_M, open_m, *gaps)))
    return replace(rig, cameras=tuple(cameras))
