"""Calibrates a rig (where cameras stand, their lenses, their clocks) from a board that some of them see at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import cv2
import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import inverse_pose
from twin_node.rig.calibrate.boards import Board, Corners
from twin_node.rig.calibrate.bundle import BundleOptions, BundleResult, BundleState, Sighting, adjust, board_pays
from twin_node.rig.calibrate.intrinsics import MIN_CORNERS, BoardView, DroppedView, calibrate_lens, rms, usable
from twin_node.rig.calibrate.lenses import Lens, rays_of
from twin_node.rig.calibrate.pose_graph import PoseGraph, build_pose_graph, islands
from twin_node.rig.calibrate.rotations import as_vector
from twin_node.rig.calibrate.tracks import CornerSource, CornerTracks, StillCorners
from twin_node.rig.errors import RigError
from twin_node.scene import Float64

SETS_PER_PAIR = 25
"""Sets used of each pair of cameras (and of each camera alone), evenly spread: more of a recording add nothing new."""

CLOCK_ROUNDS = 4
"""Adjustments with corners interpolated anew at the clocks of the one before; the third moves them by 0.1 ms."""

CLOCK_SETTLED_S = 1e-4
"""Clocks that move by less than this in a round are settled."""

MISREAD_PX = 2.0
"""A corner further than this from the plane of its board is misread: sub-pixel corners and a first lens err by less."""

MOST = 0.6
"""Share of a view's corners that must lie on one plane, else the view is left out."""

OUTLIER_FACTOR = 4.0
"""A sighting whose rms is more than this times its camera's noise is dropped: a misread board, a stamp that is off."""

OUTLIER_FLOOR_PX = 0.5
"""No sighting better than this is dropped."""


@dataclass(frozen=True)
class CameraRecording:
    """What one camera saw of the board."""

    name: str
    size: tuple[int, int]
    """Width and height, pixels."""
    stamps: NDArray[np.int64]
    """[T] ns, increasing; equal numbers belong together where `moving` is False."""
    images: tuple[str, ...]
    """[T] what each image is called in messages."""
    found: tuple[Corners | None, ...]
    """[T] the board in each image."""
    moving: bool = True
    """Whether the corners may be interpolated between stamps (a video), or every image stands for itself (stills)."""
    lens: Lens | None = None
    """Where it is known already."""


@dataclass(frozen=True)
class RigOptions:
    """What is estimated beside the cameras' poses."""

    model: str = "plumb_bob"
    """Distortion model of cameras whose lens is not known."""
    lenses: bool = True
    """Refine lenses together with the poses."""
    board: bool | None = None
    """Refine the places of the board's corners: prints stretch, boards bend (the size as a whole stays as stated).
    None: where the pictures say so clearly."""
    clocks: bool = True
    """Estimate clock offsets, where the board moved."""
    partial: bool = False
    """Leave out cameras that share no set with the largest group, instead of refusing."""


@dataclass(frozen=True)
class RigSolution:
    """A calibrated rig with all that tells how good it is; its frame is the first camera's optical frame."""

    board: Board
    names: tuple[str, ...]
    """Of the connected cameras, in the given order."""
    bundle: BundleResult
    sightings: tuple[Sighting, ...]
    """Used in the bundle; `bundle.residuals` runs parallel."""
    set_stamps: NDArray[np.int64]
    """[S] time of each set, ns."""
    dropped: tuple[DroppedView, ...]
    unconnected: tuple[str, ...]
    """Cameras that share no set with the others: they are not in the result."""


def calibrate_rig(board: Board, cameras: Sequence[CameraRecording], options: RigOptions | None = None) -> RigSolution:
    """The rig that explains all cameras' views of the board best.

    Raises `RigError` for fewer than two cameras, for a board that looks the same when turned, where cameras share no
    set, directly or through others, with the largest group (unless `options.partial`), or where a camera's views do not
    determine its lens.
    """
    options = options or RigOptions()
    _check(board, cameras)
    lenses = [_lens(board, camera, options.model) for camera in cameras]
    given = cameras
    cameras = [
        replace(camera, found=tuple(_cleaned(board, lens, corners) for corners in camera.found))
        for camera, lens in zip(given, lenses, strict=True)
    ]
    sources = [_source(camera) for camera in cameras]
    all_stamps = _set_stamps(cameras)
    first_look = _sightings(board, sources, all_stamps, np.zeros(len(cameras)))
    group = max(islands(len(cameras), first_look), key=len)
    if len(group) < 2:
        alone = ", ".join(camera.name for camera in cameras)
        raise RigError(
            f"cameras {alone}: expected the board in images of two cameras at once, found it only in one at a time; "
            "check the stamps, or hold the board where several cameras see it"
        )
    left_out = tuple(camera.name for i, camera in enumerate(cameras) if i not in group)
    if left_out and not options.partial:
        raise RigError(
            f"cameras {', '.join(left_out)}: expected board views at the same time as of "
            f"{', '.join(cameras[i].name for i in group)}, found none; hold the board where both see it, "
            "or go on without them (--partial)"
        )
    members = [cameras[i] for i in group]
    own = [Sighting(group.index(s.camera), s.board, s.corners) for s in first_look if s.camera in group]
    stamps = all_stamps[_spread(own, len(group))]
    solved = _solve(board, members, [lenses[i] for i in group], stamps, options)
    names = tuple(camera.name for camera in members)
    return RigSolution(
        board,
        names,
        solved.bundle,
        solved.sightings,
        solved.set_stamps,
        (*_misread(given, cameras), *solved.dropped),
        left_out,
    )


def simultaneous(board: Board, cameras: Sequence[CameraRecording], clocks: Float64) -> list[Sighting]:
    """What the cameras saw of the board at the same times; `clocks` [C]: seconds to add to their stamps."""
    return _sightings(board, [_source(camera) for camera in cameras], _set_stamps(cameras), clocks)


@dataclass(frozen=True)
class _Solved:
    bundle: BundleResult
    sightings: tuple[Sighting, ...]
    set_stamps: NDArray[np.int64]
    dropped: tuple[DroppedView, ...]


def _solve(
    board: Board,
    cameras: Sequence[CameraRecording],
    lenses: Sequence[Lens],
    stamps: NDArray[np.int64],
    options: RigOptions,
) -> _Solved:
    """Adjusts, sets the clocks, interpolates the corners anew and drops what does not fit, until nothing changes."""
    sources = [_source(camera) for camera in cameras]
    bundle_options = BundleOptions(options.lenses, bool(options.board), options.clocks)
    clocks, bad = np.zeros(len(cameras)), set[_Place]()
    dropped: list[DroppedView] = []
    for _ in range(CLOCK_ROUNDS):
        sightings = [
            s for s in _sightings(board, sources, stamps, clocks) if _Place(s.camera, int(stamps[s.board])) not in bad
        ]
        used = sorted({s.board for s in sightings})
        stamps = stamps[used]
        sightings = [replace(s, board=used.index(s.board)) for s in sightings]
        graph = build_pose_graph(lenses, board.points, sightings)
        start = _start(graph, lenses, board, clocks)
        bundle = adjust(start, sightings, bundle_options)
        moved = float(np.abs(bundle.state.clocks - clocks).max())
        clocks, lenses = bundle.state.clocks, bundle.state.lenses
        outliers = _outliers(bundle, sightings)
        if moved < CLOCK_SETTLED_S and not outliers:
            break
        for n in outliers:
            camera, stamp = sightings[n].camera, int(stamps[sightings[n].board])
            bad.add(_Place(camera, stamp))
            dropped.append(DroppedView(_image_at(cameras[camera], stamp), f"rms {rms([bundle.residuals[n]]):.2f} px"))
    if options.board is None:
        bent = adjust(replace(bundle.state, clocks=start.clocks), sightings, replace(bundle_options, board=True))
        bundle = bent if board_pays(bundle, bent, sightings) else bundle
    return _Solved(bundle, tuple(sightings), stamps, tuple(dropped))


@dataclass(frozen=True)
class _Place:
    """A camera's view of one set."""

    camera: int
    stamp: int


def _check(board: Board, cameras: Sequence[CameraRecording]) -> None:
    if len(cameras) < 2:
        raise RigError(f"rig: expected at least two cameras, found {len(cameras)}; give a folder with one video each")
    if board.turns > 1:
        raise RigError(
            f"{board}: expected a board that looks different when turned by 180 degrees, so that all cameras agree on "
            "its corners; use ChArUco, an AprilGrid or a chessboard with an even and an odd number of inner corners"
        )


def _lens(board: Board, camera: CameraRecording, model: str) -> Lens:
    """The lens that is known, or the best from the camera's own views."""
    if camera.lens is not None:
        return camera.lens
    views = [
        BoardView(name, corners)
        for name, corners in zip(camera.images, camera.found, strict=True)
        if corners is not None and usable(board, corners)
    ]
    chosen = [views[i] for i in _evenly(len(views), SETS_PER_PAIR)]
    return calibrate_lens(board, chosen, camera.size, model, source=f"camera {camera.name}").lens


def _cleaned(board: Board, lens: Lens, corners: Corners | None) -> Corners | None:
    """The corners that lie on one plane (RANSAC); None where most do not: interpolation would spread what is wrong."""
    if corners is None or len(corners) < MIN_CORNERS:
        return None
    flat = rays_of(lens, corners.pixels) * lens.K[0, 0]
    _, mask = cv2.findHomography(board.points[corners.ids, :2], flat, cv2.RANSAC, MISREAD_PX)
    good = np.zeros(len(corners), dtype=bool) if mask is None else np.asarray(mask).ravel() > 0
    if good.mean() < MOST:
        return None
    return Corners(corners.ids[good], corners.pixels[good])


def _misread(given: Sequence[CameraRecording], cleaned: Sequence[CameraRecording]) -> list[DroppedView]:
    """The images in which cleaning left too little of a board."""
    return [
        DroppedView(f"{camera.name}: {name}", "corners that lie on no plane")
        for camera, clean in zip(given, cleaned, strict=True)
        for name, corners, rest in zip(camera.images, camera.found, clean.found, strict=True)
        if corners is not None and len(corners) >= MIN_CORNERS and rest is None
    ]


def _source(camera: CameraRecording) -> CornerSource:
    if camera.moving:
        return CornerTracks(camera.stamps, camera.found)
    return StillCorners(camera.stamps, camera.found)


def _set_stamps(cameras: Sequence[CameraRecording]) -> NDArray[np.int64]:
    """Times, ns, at which the board is looked at: where some camera saw it, no two closer than frames are.

    More would use the same images twice and claim certainty that is not there.
    """
    seen = np.unique(
        [t for camera in cameras for t, corners in zip(camera.stamps, camera.found, strict=True) if corners is not None]
    )
    if not all(camera.moving for camera in cameras):
        return np.asarray(seen, np.int64)
    apart = 0.9 * min(float(np.median(np.diff(camera.stamps))) for camera in cameras if len(camera.stamps) > 1)
    chosen: list[int] = []
    for stamp in seen.tolist():
        if not chosen or stamp - chosen[-1] >= apart:
            chosen.append(stamp)
    return np.array(chosen, dtype=np.int64)


def _sightings(
    board: Board, sources: Sequence[CornerSource], stamps: NDArray[np.int64], clocks: Float64
) -> list[Sighting]:
    """What each camera saw at each set's time; a camera that is `clocks` late saw it earlier by its own stamps."""
    sightings = []
    for number, stamp in enumerate(stamps.tolist()):
        for camera, source in enumerate(sources):
            seen = source.at(stamp - round(float(clocks[camera]) * 1e9))
            if seen is not None and usable(board, seen.corners):
                sightings.append(Sighting(camera, number, seen.corners, seen.velocities, seen.jitter_px))
    return sightings


def _spread(sightings: Sequence[Sighting], cameras: int) -> list[int]:
    """Sets to use: of each pair of cameras, and of each camera alone, evenly over those that it saw."""
    seen_by: dict[int, set[int]] = {}
    for sighting in sightings:
        seen_by.setdefault(sighting.board, set()).add(sighting.camera)
    chosen: set[int] = set()
    for group in [*combinations(range(cameras), 2), *((camera,) for camera in range(cameras))]:
        sets = [board for board, seen in seen_by.items() if seen.issuperset(group)]
        chosen.update(sets[i] for i in _evenly(len(sets), SETS_PER_PAIR))
    return sorted(chosen)


def _evenly(count: int, limit: int) -> list[int]:
    """At most `limit` of `count` places, evenly spread."""
    return sorted(set(np.linspace(0, count - 1, min(count, limit)).round().astype(int).tolist()))


def _start(graph: PoseGraph, lenses: Sequence[Lens], board: Board, clocks: Float64) -> BundleState:
    cameras = np.stack([as_vector(inverse_pose(graph.T_rig_cam[i])) for i in range(len(lenses))])
    boards = np.stack([as_vector(graph.T_rig_board[i]) for i in range(len(graph.T_rig_board))])
    return BundleState(cameras, boards, tuple(lenses), board.points, clocks)


def _outliers(bundle: BundleResult, sightings: Sequence[Sighting]) -> list[int]:
    limits = np.maximum(OUTLIER_FACTOR * np.sqrt(2) * bundle.noise_px, OUTLIER_FLOOR_PX)
    return [
        n
        for n, (sighting, residual) in enumerate(zip(sightings, bundle.residuals, strict=True))
        if rms([residual]) > limits[sighting.camera]
    ]


def _image_at(camera: CameraRecording, stamp: int) -> str:
    return f"{camera.name}: {camera.images[int(np.abs(camera.stamps - stamp).argmin())]}"
