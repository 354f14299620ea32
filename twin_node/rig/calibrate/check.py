"""Looks for the customary mistakes in a rig file: by its own numbers, and by a board that its cameras saw."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from twin_node.geometry import inverse_pose
from twin_node.rig.calibrate.boards import Board
from twin_node.rig.calibrate.bundle import Sighting
from twin_node.rig.calibrate.rig_fit import fit
from twin_node.scene import Float64, Rig, RigCamera

GOOD_SHARE = 0.003
"""Median error of every camera of a rig that is usable, as a share of the image's width (2 pixels of 640)."""

TELLING_FACTOR = 3.0
"""A mistake is named where undoing it divides the worst camera's median error by this."""

SETS_JUDGED = 12
"""Sets, evenly picked, on which the mistakes are compared: each is off by far more than single sets err."""

RATIOS = (1 / 3, 1 / 2, 2 / 3, 3 / 4, 4 / 3, 3 / 2, 2.0, 3.0)
"""Of customary resolutions to each other."""

CENTRE_LIMIT = 0.2
"""A principal point further from the middle of the image than this share of its size is suspicious."""

SAME_SHARE = 0.1
"""Largest difference between the horizontal and the vertical place of a principal point that a rescaled K leaves."""


@dataclass(frozen=True)
class Finding:
    """Something wrong with a rig, in one line."""

    camera: str
    """Its name; several, joined by commas; empty for all."""
    cause: str
    """The likely mistake, and what to do."""

    def __str__(self) -> str:
        return f"camera {self.camera}: {self.cause}" if self.camera else f"all cameras: {self.cause}"


@dataclass(frozen=True)
class _Undone:
    """The rig as it would be without a mistake."""

    finding: Finding
    rig: Rig


def check_numbers(rig: Rig) -> list[Finding]:
    """What the numbers alone tell, beyond what `load_rig` refuses."""
    return [
        Finding(
            camera.name,
            f"expected a principal point near the middle of {camera.width}x{camera.height}, found "
            f"({camera.K[0, 2]:.0f}, {camera.K[1, 2]:.0f}); is K of another resolution "
            f"(about {2 * camera.K[0, 2]:.0f}x{2 * camera.K[1, 2]:.0f})?",
        )
        for camera in rig.cameras
        if _of_other_resolution(camera)
    ]


def check_against_board(board: Board, rig: Rig, sightings: Sequence[Sighting]) -> list[Finding]:
    """What sightings of a board by several cameras at once tell.

    The rig is good where it explains them; else every customary mistake is undone in turn, and the one that explains
    them best is named. Where none does, the camera that fits worst is. `rig` may be any that `load_rig` reads; what it
    refuses needs no picture.
    """
    limit = GOOD_SHARE * max(camera.width for camera in rig.cameras)
    if _Misfit.of(board, rig, sightings).worst_px < limit:
        return []
    few = _some_sets(sightings)
    now, undone = _Misfit.of(board, rig, few), list(_undone(rig))
    errors = [_Misfit.of(board, mistake.rig, few).worst_px for mistake in undone]
    best = int(np.argmin(errors))
    if errors[best] < now.worst_px / TELLING_FACTOR:
        found = undone[best].finding
        return [
            Finding(found.camera, f"{found.cause} (median error {now.worst_px:.1f} px, then {errors[best]:.1f} px)")
        ]
    return [
        Finding(
            now.worst, f"its median error is {now.worst_px:.1f} px and no customary mistake explains it: calibrate anew"
        )
    ]


@dataclass(frozen=True)
class _Misfit:
    """The camera that a rig explains worst."""

    worst: str
    worst_px: float
    """Its median error, pixels."""

    @classmethod
    def of(cls, board: Board, rig: Rig, sightings: Sequence[Sighting]) -> _Misfit:
        """Of a rig on sightings."""
        result = fit(board, rig, sightings)
        residuals = {camera.name: result.of_camera(number) for number, camera in enumerate(rig.cameras)}
        errors = {name: float(np.median(np.linalg.norm(r, axis=1))) for name, r in residuals.items() if r is not None}
        worst = max(errors, key=lambda name: errors[name])
        return cls(worst, errors[worst])


def _some_sets(sightings: Sequence[Sighting]) -> list[Sighting]:
    boards = sorted({sighting.board for sighting in sightings})
    chosen = {boards[i] for i in np.linspace(0, len(boards) - 1, SETS_JUDGED).round().astype(int)}
    return [sighting for sighting in sightings if sighting.board in chosen]


def _undone(rig: Rig) -> Iterator[_Undone]:
    """The rig with each mistake undone, of all cameras and of each alone."""
    cameras = rig.cameras
    for factor, unit in ((1e-3, "millimetres"), (1e-2, "centimetres"), (0.0254, "inches"), (1e3, "kilometres")):
        scaled = [_moved(c, _scaled(c.T_base_cam, factor)) for c in cameras]
        yield _Undone(Finding("", f"translations seem to be in {unit}: write metres"), _with(rig, scaled))
    readings = {
        "axes seem to be OpenGL's (z backward): negate columns 2 and 3 of the rotation": _opengl,
        "the rotation seems to be transposed: transpose it and keep the translation": _transposed,
        "the pose seems to be base-to-camera (R, t): invert it": inverse_pose,
    }
    for cause, undo in readings.items():
        everywhere = [_moved(c, undo(c.T_base_cam)) for c in cameras]
        yield _Undone(Finding("", cause), _with(rig, everywhere))
        for i, camera in enumerate(cameras):
            alone = [*cameras[:i], everywhere[i], *cameras[i + 1 :]]
            yield _Undone(Finding(camera.name, cause), _with(rig, alone))
    yield from _swapped(rig)
    yield from _rescaled(rig)


def _swapped(rig: Rig) -> Iterator[_Undone]:
    """Two cameras under each other's names, or only their poses."""
    for a, b in combinations(range(len(rig.cameras)), 2):
        first, second = rig.cameras[a], rig.cameras[b]
        names = f"{first.name}, {second.name}"
        whole = {a: replace(second, name=first.name), b: replace(first, name=second.name)}
        poses = {a: _moved(first, second.T_base_cam), b: _moved(second, first.T_base_cam)}
        for swapped, what in ((whole, "they"), (poses, "their poses")):
            cameras = [swapped.get(i, camera) for i, camera in enumerate(rig.cameras)]
            yield _Undone(Finding(names, f"{what} seem to be swapped: exchange them"), _with(rig, cameras))


def _rescaled(rig: Rig) -> Iterator[_Undone]:
    """K of another resolution, of all cameras or of one."""
    for ratio in RATIOS:
        scaled = [_resized(camera, ratio) for camera in rig.cameras]
        of = f"K seems to be of {ratio:.3g} times the image's resolution: scale it"
        yield _Undone(Finding("", of), _with(rig, scaled))
        for i, camera in enumerate(rig.cameras):
            alone = [*rig.cameras[:i], scaled[i], *rig.cameras[i + 1 :]]
            yield _Undone(Finding(camera.name, of), _with(rig, alone))


def _resized(camera: RigCamera, ratio: float) -> RigCamera:
    """The camera with K divided by a ratio of resolutions; pixel centres are whole numbers."""
    K = camera.K / ratio
    K[:2, 2] = (camera.K[:2, 2] + 0.5) / ratio - 0.5
    K[2, 2] = 1
    return replace(camera, K=K)


def _scaled(T: Float64, factor: float) -> Float64:
    """A pose with its translation multiplied."""
    scaled = T.copy()
    scaled[:3, 3] *= factor
    return scaled


def _opengl(T: Float64) -> Float64:
    return np.asarray(T * np.array([1.0, -1.0, -1.0, 1.0]))


def _transposed(T: Float64) -> Float64:
    transposed = T.copy()
    transposed[:3, :3] = T[:3, :3].T
    return transposed


def _moved(camera: RigCamera, T_base_cam: Float64) -> RigCamera:
    return replace(camera, T_base_cam=T_base_cam)


def _with(rig: Rig, cameras: Sequence[RigCamera]) -> Rig:
    return replace(rig, cameras=tuple(cameras))


def _of_other_resolution(camera: RigCamera) -> bool:
    """Whether the principal point is off along both axes alike."""
    shares = np.array([(camera.K[0, 2] + 0.5) / camera.width, (camera.K[1, 2] + 0.5) / camera.height])
    return bool(abs(shares.mean() - 0.5) > CENTRE_LIMIT and abs(shares[0] - shares[1]) < SAME_SHARE)
