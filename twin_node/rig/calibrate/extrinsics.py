"""Calibrates a rig (where cameras stand, their lenses, their clocks) from a board that some of them see at once."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from twin_node.rig.calibrate.boards import Board, Corners
from twin_node.rig.calibrate.bundle import BoardFreedom, BundleOptions, BundleResult, Sighting
from twin_node.rig.calibrate.bundle_solver import solve_bundle, with_board_that_pays
from twin_node.rig.calibrate.contradictions import check_board, check_clocks, check_fit, check_lenses
from twin_node.rig.calibrate.intrinsics import MIN_CORNERS, BoardView, DroppedView, calibrate_lens, usable
from twin_node.rig.calibrate.islands import islands
from twin_node.rig.calibrate.lenses import Lens, homogeneous, pixel_rays
from twin_node.rig.calibrate.rig_start import SETS_PER_PAIR, Start, check_turns, set_stamps, simultaneous, start_of
from twin_node.rig.calibrate.steadiness import check_steady
from twin_node.rig.calibrate.tracks import CameraRecording
from twin_node.rig.calibrate.witnesses import Witnesses
from twin_node.rig.errors import RigError
from twin_node.scene import Float64
from twin_node.thinning import thinned

MISREAD_SHARE = 1 / 320
"""A corner further than this share of its image's width from the plane of its board is misread: corners, which are no
sharper in large images, and a first lens err by less."""

MOST = 0.6
"""Share of a view's corners that must lie on one plane, else the view is left out."""
DRAWS = 200
"""Of four corners, to find the plane of a board: where `MOST` lie on it, all draws miss it once in 10^12 views."""


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
    base_ns: int | None = None
    """Stamp at which the board lies on the base: of long recordings only parts are used, and this is one of them."""


@dataclass(frozen=True)
class RigSolution:
    """A calibrated rig with all that tells how good it is; its frame is the first camera's optical frame."""

    board: Board
    names: tuple[str, ...]
    """Of the connected cameras, in the given order."""
    bundle: BundleResult
    origin_ns: int
    """Stamp at which the time of the board's course is 0."""
    dropped: tuple[DroppedView, ...]
    unconnected: tuple[str, ...]
    """Cameras that share no set with the others: they are not in the result."""

    @property
    def reference_ns(self) -> int:
        """Stamp at which the clocks' offsets hold."""
        return self.origin_ns + round(self.bundle.state.reference_s * 1e9)


def calibrate_rig(board: Board, cameras: Sequence[CameraRecording], options: RigOptions | None = None) -> RigSolution:
    """The rig that explains all cameras' views of the board best.

    Raises `RigError` for fewer than two cameras, for a board that looks the same when turned, where cameras share no
    set, directly or through others, with the largest group (unless `options.partial`), where a camera's views do not
    determine its lens, or where the views contradict each other.
    """
    options = options or RigOptions()
    _check(board, cameras)
    lenses = [_lens(board, camera, options.model) for camera in cameras]
    given = cameras
    cameras = [
        replace(camera, found=tuple(_cleaned(board, lens, corners) for corners in camera.found))
        for camera, lens in zip(given, lenses, strict=True)
    ]
    stamps = set_stamps(cameras)
    first_look = simultaneous(board, cameras, stamps, np.tile(stamps, (len(cameras), 1)))
    first_in: dict[int, int] = {}
    links = [(first_in.setdefault(s.board, s.camera), s.camera) for s in first_look]
    group = max(islands(len(cameras), links), key=len)
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
    start = start_of(board, members, [lenses[i] for i in group], own, stamps, options.base_ns)
    bundle = _solved(start, options)
    moving, names = all(camera.moving for camera in members), tuple(camera.name for camera in members)
    check_board(board, bundle)
    witnesses = Witnesses.of(start.sightings, bundle)
    if not options.clocks:
        check_clocks(names, witnesses)
    check_fit(names, start.state.lenses, start.sightings, bundle, moving)
    if not options.lenses:
        check_lenses(names, witnesses)
    check_steady(names, witnesses)
    return RigSolution(
        board,
        names,
        bundle,
        start.origin_ns,
        (*_misread(given, cameras), *_unfitting(start, bundle)),
        left_out,
    )


def _solved(start: Start, options: RigOptions) -> BundleResult:
    """The bundle, over a bent board where that was asked for or pays."""
    board = BoardFreedom.BENT if options.board else BoardFreedom.FLAT
    free = BundleOptions(options.lenses, board, options.clocks)
    bundle = solve_bundle(start.state, start.sightings, free)
    if options.board is None:
        return with_board_that_pays(bundle, start.sightings, free)
    return bundle


def _unfitting(start: Start, bundle: BundleResult) -> list[DroppedView]:
    """The images that the bundle left out."""
    lost = {id(sighting) for sighting in bundle.left_out}
    return [
        DroppedView(name, "fits no place of the board that other images leave")
        for sighting, name in zip(start.sightings, start.images, strict=True)
        if id(sighting) in lost
    ]


def _check(board: Board, cameras: Sequence[CameraRecording]) -> None:
    if len(cameras) < 2:
        raise RigError(f"rig: expected at least two cameras, found {len(cameras)}; give a folder with one video each")
    check_turns(board)


def _lens(board: Board, camera: CameraRecording, model: str) -> Lens:
    """The lens that is known, or the best from the camera's own views."""
    if camera.lens is not None:
        return camera.lens
    views = [
        BoardView(name, corners)
        for name, corners in zip(camera.images, camera.found, strict=True)
        if corners is not None and usable(board, corners)
    ]
    chosen = thinned(views, SETS_PER_PAIR)
    return calibrate_lens(board, chosen, camera.size, model, source=f"camera {camera.name}").lens


def _cleaned(board: Board, lens: Lens, corners: Corners | None) -> Corners | None:
    """The corners that lie on one plane (RANSAC); None where most do not: interpolation would spread what is wrong."""
    if corners is None or len(corners) < MIN_CORNERS:
        return None
    flat = _seen_straight(pixel_rays(lens, corners.pixels)) * lens.K[0, 0]
    _, mask = cv2.findHomography(
        board.points[corners.ids, :2], flat, cv2.RANSAC, MISREAD_SHARE * lens.width, maxIters=DRAWS
    )
    good = np.zeros(len(corners), dtype=bool) if mask is None else np.asarray(mask).ravel() > 0
    if good.mean() < MOST:
        return None
    return corners.chosen(good)


def _seen_straight(rays: Float64) -> Float64:
    """Rays [N, 2] (x/z, y/z) as if the lens had looked at their middle: at a fisheye's edge a pixel makes x/z a lot."""
    ways = homogeneous(rays)
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    straight, *_ = Rotation.align_vectors([[0.0, 0.0, 1.0]], [ways.mean(axis=0)])
    turned = straight.apply(ways)
    return np.asarray(turned[:, :2] / turned[:, 2:])


def _misread(given: Sequence[CameraRecording], cleaned: Sequence[CameraRecording]) -> list[DroppedView]:
    """The images in which cleaning left too little of a board."""
    return [
        DroppedView(f"{camera.name}: {name}", "corners that lie on no plane")
        for camera, clean in zip(given, cleaned, strict=True)
        for name, corners, rest in zip(camera.images, camera.found, clean.found, strict=True)
        if corners is not None and len(corners) >= MIN_CORNERS and rest is None
    ]
