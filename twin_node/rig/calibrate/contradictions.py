"""Whether images fit one rig at all: wrong stamps bend every fit, and figures of what is left would not tell."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from twin_node.geometry import transform
from twin_node.rig.calibrate.board_shape import board_shape, corner_step
from twin_node.rig.calibrate.boards import Board
from twin_node.rig.calibrate.bundle import BundleResult, Sighting
from twin_node.rig.calibrate.lenses import Lens, project
from twin_node.rig.calibrate.pose_graph import board_pose
from twin_node.rig.calibrate.stamp_jitter import MOST_JITTER_S
from twin_node.rig.calibrate.steadiness import check_steady, most_gained
from twin_node.rig.calibrate.witnesses import MOST_GAIN, Witnesses
from twin_node.rig.errors import RigError
from twin_node.scene import Float64

MOST_WORSE, LEAST_PX = 8.0, 0.5
"""Images of one rig fit it up to so many times worse than each fits a place of its own; less than so many pixels is no
matter. A good recording of rolling shutters and free clocks (`charuco_4cam`) has 1.4 times; stamps that are seconds off
have 11 times and more."""

MOST_LEFT_OUT = 0.15
"""Share of all images of a moved board that a fit may do without. Good recordings lose 1 %."""

MOST_UNLIKE = 0.02
"""Share of the distance between corners, within the plane of the board. Prints are good to a tenth of it; gaps of 0.3
stated as 0.28 make it up."""

FAR_MORE = 3.0
"""Where a camera that was moved would explain so many times as much as another lens or clock does, it was moved: lenses
1.5 to 4 % off leave 1.1 to 1.5 times, cameras moved by 10 mm 75 times."""

CAUSE = (
    "are the stamps those of its frames, in seconds, and the cameras' clocks within a second of each other all along? "
    "Nor may a camera be moved"
)


def check_fit(
    names: Sequence[str], lenses: Sequence[Lens], given: Sequence[Sighting], bundle: BundleResult, moving: bool
) -> None:
    """Raises `RigError` where cameras' images contradict each other.

    `lenses`: as each camera's own images tell them; `given`: the sightings that the bundle was made of.
    """
    for camera, (name, lens) in enumerate(zip(names, lenses, strict=True)):
        if bundle.jitter_s[camera] >= MOST_JITTER_S:
            raise RigError(
                f"camera {name}: expected stamps that are right to {1e3 * MOST_JITTER_S:g} ms, one by one, found them "
                f"off by that and more; {CAUSE}"
            )
        fits = [(s, r) for s, r in zip(bundle.sightings, bundle.residuals, strict=True) if s.camera == camera]
        if not fits:
            raise RigError(f"camera {name}: expected images that fit the other cameras', found none that do; {CAUSE}")
        together = _median([residual for _, residual in fits])
        alone = _alone(lens, bundle.state.points, [sighting for sighting, _ in fits])
        if together > max(LEAST_PX, MOST_WORSE * alone):
            raise RigError(
                f"camera {name}: expected images that fit the other cameras', found them {together:.2f} px off where "
                f"each by itself is {alone:.2f} px off; {CAUSE}"
            )
    if moving and len(bundle.left_out) > MOST_LEFT_OUT * len(given):
        lost = [
            f"{sum(s.camera == i for s in bundle.left_out)} of {sum(s.camera == i for s in given)} of {name}"
            for i, name in enumerate(names)
        ]
        raise RigError(
            f"cameras {', '.join(names)}: expected images that fit one course of the board, found that many do not "
            f"({', '.join(lost)}); {CAUSE}"
        )


def check_board(board: Board, bundle: BundleResult) -> None:
    """Raises `RigError` where the board is another one than was stated, so that its size is unknown."""
    unlike_m, step_m = board_shape(board.points, bundle.state.points).unlike_m, corner_step(board.points)
    if unlike_m > MOST_UNLIKE * step_m:
        raise RigError(
            f"board: expected {board}, found its corners {1e3 * unlike_m:.1f} mm off that, as neither stretching nor "
            "bending explains; measure its squares, or its tags and their gaps"
        )


def check_lenses(names: Sequence[str], witnesses: Witnesses) -> None:
    """Raises `RigError` where lenses that were fixed are not those of the images, and places come out wrong by it.

    Distances to a board take up what a focal length is off by: such images fit nearly as well. A camera that was moved
    meanwhile may want another lens, too, and is told so.
    """
    told = list(zip(names, witnesses.bundle.state.lenses, witnesses.other_lenses(), strict=True))
    name, lens, worst = max(told, key=lambda one: one[2].gain)
    if worst.gain > MOST_GAIN and worst.matters:
        _check_moved(names, witnesses, worst.gain)
        raise RigError(
            f"camera {name}: expected images through the lens given, which is fixed, of focal length "
            f"{lens.K[0, 0]:.1f} px, found some that fit {worst.focal_px:.1f} px and cameras up to "
            f"{1e3 * worst.shift_m:.0f} mm and {np.degrees(worst.turn_rad):.1f} degrees elsewhere; was it focused "
            "meanwhile, or is the board not flat? Leave out --fixed-lenses, or --board-shape flat"
        )


def check_clocks(names: Sequence[str], witnesses: Witnesses) -> None:
    """Raises `RigError` where clocks that were fixed, as those of cameras that share a trigger, differ.

    What clocks are off by bends places: cameras would be told to have moved. One that was moved meanwhile may want
    another clock, too, and is told so.
    """
    told = witnesses.other_clocks()
    if told.gain > MOST_GAIN and told.matter:
        _check_moved(names, witnesses, told.gain)
        off = [f"{name}'s {1e3 * abs(s):.0f} ms" for name, s in zip(names[1:], told.later_s[1:], strict=True)]
        raise RigError(
            f"cameras {', '.join(names)}: expected stamps of one clock, as --fixed-clocks says, found them off those "
            f"of {names[0]}, by a first guess {', '.join(off)}; leave out --fixed-clocks"
        )


def _check_moved(names: Sequence[str], witnesses: Witnesses, gain: float) -> None:
    """Raises `RigError` where a camera was moved that explains far more than what else was found does, by its gain."""
    if most_gained(witnesses) > FAR_MORE * gain:
        check_steady(names, witnesses)


def _alone(lens: Lens, points: Float64, sightings: Sequence[Sighting]) -> float:
    """Median distance, pixels, of corners from a board [P, 3] that lies wherever the image itself wants it."""
    residuals = []
    for corners in (sighting.corners for sighting in sightings):
        T = board_pose(lens, points[corners.ids], corners.pixels)
        if T is not None:
            residuals.append(corners.pixels - project(lens, transform(T, points[corners.ids])).pixels)
    return _median(residuals) if residuals else np.inf


def _median(residuals: Sequence[Float64]) -> float:
    return float(np.median(np.linalg.norm(np.concatenate(residuals), axis=1)))
