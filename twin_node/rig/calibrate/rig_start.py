"""What a rig's adjustment begins with: which images to use, and where cameras and board are, roughly."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import combinations

import numpy as np
from numpy.typing import NDArray

from twin_node.geometry import inverse_pose
from twin_node.rig.calibrate.boards import Board
from twin_node.rig.calibrate.bundle import BundleState, Sighting
from twin_node.rig.calibrate.course import Course, smooth_course, still_course
from twin_node.rig.calibrate.intrinsics import usable
from twin_node.rig.calibrate.lenses import Lens
from twin_node.rig.calibrate.pose_graph import PoseGraph, board_pose, build_pose_graph
from twin_node.rig.calibrate.tracks import CameraRecording, source_of
from twin_node.rig.errors import RigError
from twin_node.scene import Float64
from twin_node.thinning import thinned

SETS_PER_PAIR = 25
"""Sets used of each pair of cameras (and of each camera alone), evenly spread: more add nothing new to a first guess,
or to boards held still."""

WINDOWS_PER_PAIR, WINDOW_S = 16, 2.0
"""Parts of a moving board's course used of each pair of cameras (and of each camera alone), and their length."""

STEP_S = 0.1
"""Time between control poses of a board's course, however slow the cameras are: hands turn about at up to 3 Hz."""

LEAST_PERIOD = 0.6
"""Images of one camera closer than this share of a step say little more than one of them."""

PAUSE_STEPS = 3.0
"""A pause longer than so many steps, or periods of the cameras, in which none sees the board, ends a stretch of its
course."""


@dataclass(frozen=True)
class Start:
    """A first guess and what was seen."""

    state: BundleState
    sightings: tuple[Sighting, ...]
    images: tuple[str, ...]
    """Per sighting: camera and image, for messages."""
    origin_ns: int
    """Stamp from which times count."""


def check_turns(board: Board) -> None:
    """Raises `RigError` for a board whose corners cameras may number from either end."""
    if board.turns > 1:
        raise RigError(
            f"{board}: expected a board that looks different when turned by 180 degrees, so that all cameras agree on "
            "its corners; use ChArUco, an AprilGrid, a chessboard with an even and an odd number of inner corners, or "
            "asymmetric circles of an odd number of rows"
        )


def set_stamps(cameras: Sequence[CameraRecording]) -> NDArray[np.int64]:
    """Times, ns, at which some camera saw the board, no two closer than frames of a video are."""
    seen = np.unique(
        [t for camera in cameras for t, corners in zip(camera.stamps, camera.found, strict=True) if corners is not None]
    )
    if not all(camera.moving for camera in cameras):
        return np.asarray(seen, np.int64)
    apart = 0.9e9 * min(camera.period_s for camera in cameras)
    chosen: list[int] = []
    for stamp in seen.tolist():
        if not chosen or stamp - chosen[-1] >= apart:
            chosen.append(stamp)
    return np.array(chosen, dtype=np.int64)


def simultaneous(
    board: Board, cameras: Sequence[CameraRecording], stamps: NDArray[np.int64], own_stamps: NDArray[np.int64]
) -> list[Sighting]:
    """What the cameras saw of the board at the same times.

    `stamps` [S] ns on the rig's clock: one set each; `own_stamps` [C, S]: the same times on the cameras' clocks.
    Corners of moving boards are interpolated between images.
    """
    sources = [source_of(camera) for camera in cameras]
    return [
        Sighting(camera, number, corners)
        for number in range(len(stamps))
        for camera, source in enumerate(sources)
        if (corners := source.at(int(own_stamps[camera, number]))) is not None and usable(board, corners)
    ]


def start_of(
    board: Board,
    cameras: Sequence[CameraRecording],
    lenses: Sequence[Lens],
    first_look: Sequence[Sighting],
    stamps: NDArray[np.int64],
    wanted_ns: int | None = None,
) -> Start:
    """A first guess of a rig; `first_look`: sightings in sets at `stamps` (ns) that hold all cameras together.

    `wanted_ns`: a stamp whose images are used in any case. Raises `RigError` where a lens allows no pose of the board.
    """
    chosen = _spread(first_look, len(cameras), SETS_PER_PAIR)
    if wanted_ns is not None:
        nearest = min((s.board for s in first_look), key=lambda board: abs(int(stamps[board]) - wanted_ns))
        chosen = sorted({*chosen, nearest})
    origin = int(stamps[0])
    sets = [
        Sighting(s.camera, chosen.index(s.board), s.corners, (int(stamps[s.board]) - origin) / 1e9)
        for s in first_look
        if s.board in chosen
    ]
    graph = build_pose_graph(lenses, board.points, sets)
    _check_connected(graph, [camera.name for camera in cameras], len(chosen))
    T_rig_cam = np.stack([graph.T_rig_cam[i] for i in range(len(cameras))])
    if all(camera.moving for camera in cameras):
        pause_s = PAUSE_STEPS * max(STEP_S, float(np.median([camera.period_s for camera in cameras])))
        windows = _windows(first_look, len(cameras), stamps)
        if wanted_ns is not None:
            windows.add(int((wanted_ns - origin) / 1e9 // WINDOW_S))
        seen = _in_stretches([*_images(board, cameras, lenses, origin, windows)], pause_s)
        course = _moving_course(T_rig_cam, seen)
        clocks_hold_at_s = _whole_second(origin, float(np.mean([s.time_s for s in seen.sightings])))
    else:
        seen = _Seen(tuple(sets), tuple(_image_at(cameras[s.camera], int(stamps[chosen[s.board]])) for s in sets))
        course = still_course(np.stack([graph.T_rig_board[i] for i in range(len(chosen))]))
        clocks_hold_at_s = 0.0
    state = BundleState(
        T_cam_rig=inverse_pose(T_rig_cam),
        course=course,
        lenses=tuple(lenses),
        points=board.points,
        clocks=np.zeros((len(cameras), 2)),
        readouts=np.zeros(len(cameras)),
        delays=np.zeros(len(seen.sightings)),
        reference_s=clocks_hold_at_s,
    )
    return Start(state, seen.sightings, seen.names, origin)


def _moving_course(T_rig_cam: Float64, seen: _Seen) -> Course:
    """The board's, near where each image alone has it."""
    times, places = [], []
    for stretch in range(seen.sightings[-1].board + 1):
        own = [(s, T) for s, T in zip(seen.sightings, seen.poses, strict=True) if s.board == stretch]
        times.append(np.array([s.time_s for s, _ in own]))
        places.append(np.stack([T_rig_cam[s.camera] @ T for s, T in own]))
    return smooth_course(times, places, STEP_S)


def _check_connected(graph: PoseGraph, names: Sequence[str], boards: int) -> None:
    missing = [name for i, name in enumerate(names) if i not in graph.T_rig_cam]
    if missing or len(graph.T_rig_board) < boards:
        raise RigError(
            f"cameras {', '.join(missing or names)}: expected views that tell where the board is, found some that fit "
            "no place; calibrate the lenses from boards that are tilted to all sides"
        )


def _whole_second(origin: int, time_s: float) -> float:
    """The time (s from `origin`, ns) of the nearest stamp in whole seconds, which files hold exactly."""
    return (round(origin / 1e9 + time_s) * 1_000_000_000 - origin) / 1e9


def _spread(sightings: Sequence[Sighting], cameras: int, limit: int) -> list[int]:
    """Sets to use: of each pair of cameras, and of each camera alone, evenly over those that it saw."""
    seen_by: dict[int, set[int]] = {}
    for sighting in sightings:
        seen_by.setdefault(sighting.board, set()).add(sighting.camera)
    chosen: set[int] = set()
    for group in [*combinations(range(cameras), 2), *((camera,) for camera in range(cameras))]:
        sets = [board for board, seen in seen_by.items() if seen.issuperset(group)]
        chosen.update(thinned(sets, limit))
    return sorted(chosen)


def _windows(first_look: Sequence[Sighting], cameras: int, stamps: NDArray[np.int64]) -> set[int]:
    """Numbers of the windows of the recording to use."""
    number = ((stamps - stamps[0]) / 1e9 // WINDOW_S).astype(int)
    once = {(s.camera, int(number[s.board])): Sighting(s.camera, int(number[s.board]), s.corners) for s in first_look}
    return set(_spread(list(once.values()), cameras, WINDOWS_PER_PAIR))


@dataclass(frozen=True)
class _Image:
    name: str
    sighting: Sighting
    T_cam_board: Float64
    """[4, 4] as the image alone has it."""


def _images(
    board: Board, cameras: Sequence[CameraRecording], lenses: Sequence[Lens], origin: int, windows: set[int]
) -> Iterator[_Image]:
    """The images of all cameras within the windows, none closer to its camera's last than makes sense.

    Those that fit no place of the board are left out.
    """
    for number, camera in enumerate(cameras):
        last = -np.inf
        for stamp, image, corners in zip(camera.stamps.tolist(), camera.images, camera.found, strict=True):
            time = (stamp - origin) / 1e9
            if corners is None or not usable(board, corners) or time // WINDOW_S not in windows:
                continue
            if time - last < LEAST_PERIOD * STEP_S:
                continue
            T = board_pose(lenses[number], board.points[corners.ids], corners.pixels)
            if T is not None:
                last = time
                yield _Image(f"{camera.name}: {image}", Sighting(number, 0, corners, time), T)


@dataclass(frozen=True)
class _Seen:
    sightings: tuple[Sighting, ...]
    names: tuple[str, ...]
    poses: tuple[Float64, ...] = ()
    """[4, 4] each, of a board that is moved: in the optical frame, as the image alone has it."""


def _in_stretches(images: Sequence[_Image], pause_s: float) -> _Seen:
    """Images in the order of time, their sightings numbered by stretch."""
    ordered = sorted(images, key=lambda image: image.sighting.time_s)
    times = np.array([image.sighting.time_s for image in ordered])
    stretches = np.concatenate([[0], np.cumsum(np.diff(times) > pause_s)])
    sightings = tuple(
        Sighting(image.sighting.camera, int(stretch), image.sighting.corners, image.sighting.time_s)
        for image, stretch in zip(ordered, stretches, strict=True)
    )
    return _Seen(sightings, tuple(image.name for image in ordered), tuple(image.T_cam_board for image in ordered))


def _image_at(camera: CameraRecording, stamp: int) -> str:
    return f"{camera.name}: {camera.images[int(np.abs(camera.stamps - stamp).argmin())]}"
