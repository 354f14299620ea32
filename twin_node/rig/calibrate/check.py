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

GOOD_SHARE = 0.005
"""Median reprojection error of a rig that is usable, as a share of the image's width (3 pixels of 640)."""

TELLING_FACTOR = 3.0
"""A mistake is named where undoing it divides the median error by this, and no other does as well."""

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
        Finding(camera.name, f"{_place(camera)}; is K of another resolution ({_resolution(camera)})?")
        for camera in rig.cameras
        if _rescaling(camera) is not None
    ]


def check_against_board(board: Board, rig: Rig, sightings: Sequence[Sighting]) -> list[Finding]:
    """What sightings of a board by several cameras at once tell.

    The rig is good where it explains them; else every customary mistake is undone in turn, and the one that explains
    them best is named. Where none does, the camera that fits worst is.
    """
    limit = GOOD_SHARE * max(camera.width for camera in rig.cameras)
    now = fit(board, rig, sightings)
    if now.median_px < limit:
        return [
            Finding(name, f"its median error is {error:.1f} px, others agree: calibrate it anew")
            for name, error in _errors(rig, now.sightings, now.residuals).items()
            if error > 2 * limit
        ]
    undone = list(_undone(rig))
    errors = [fit(board, mistake.rig, sightings).median_px for mistake in undone]
    best = int(np.argmin(errors))
    if errors[best] < now.median_px / TELLING_FACTOR:
        found = undone[best].finding
        detail = f"{found.cause} (median error {now.median_px:.1f} px, then {errors[best]:.1f} px)"
        return [Finding(found.camera, detail)]
    worst = max(_errors(rig, now.sightings, now.residuals).items(), key=lambda item: item[1])[0]
    return [Finding(worst, f"median error of the rig {now.median_px:.1f} px, and no customary mistake explains it")]


def _undone(rig: Rig) -> Iterator[_Undone]:
    """The rig with each mistake undone, of all cameras and of each alone."""
    cameras = rig.cameras
    for factor, unit in ((1e-3, "millimetres"), (1e-2, "centimetres"), (0.0254, "inches"), (1e3, "kilometres")):
        scaled = [_moved(c, _scaled(c.T_base_cam, factor)) for c in cameras]
        yield _Undone(Finding("", f"translations seem to be in {unit}: write metres"), _with(rig, scaled))
    readings = {
        "its axes seem to be OpenGL's (z backward): negate columns 2 and 3 of the rotation": _opengl,
        "its rotation seems to be transposed: transpose it and keep the translation": _transposed,
        "its pose seems to be base-to-camera (R, t): invert it": inverse_pose,
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
    for a, b in combinations(range(len(rig.cameras)), 2):
        cameras = list(rig.cameras)
        cameras[a] = replace(rig.cameras[b], name=rig.cameras[a].name)
        cameras[b] = replace(rig.cameras[a], name=rig.cameras[b].name)
        names = f"{rig.cameras[a].name}, {rig.cameras[b].name}"
        yield _Undone(Finding(names, "they seem to be swapped: exchange their names"), _with(rig, cameras))


def _rescaled(rig: Rig) -> Iterator[_Undone]:
    """K of another resolution: of the one that its principal point is the middle of."""
    scaled = []
    for camera in rig.cameras:
        factor = np.mean([camera.width / (2 * camera.K[0, 2] + 1), camera.height / (2 * camera.K[1, 2] + 1)])
        scaled.append(replace(camera, K=np.diag([factor, factor, 1.0]) @ camera.K))
    cause = "K seems to be of another resolution: scale it to the image's size"
    yield _Undone(Finding("", cause), _with(rig, scaled))
    for i, camera in enumerate(rig.cameras):
        alone = [*rig.cameras[:i], scaled[i], *rig.cameras[i + 1 :]]
        yield _Undone(Finding(camera.name, f"{cause} ({_resolution(camera)})"), _with(rig, alone))


def _errors(rig: Rig, sightings: Sequence[Sighting], residuals: Sequence[Float64]) -> dict[str, float]:
    """Median error per camera, pixels."""
    lengths: dict[str, list[Float64]] = {}
    for sighting, residual in zip(sightings, residuals, strict=True):
        lengths.setdefault(rig.cameras[sighting.camera].name, []).append(np.linalg.norm(residual, axis=1))
    return {name: float(np.median(np.concatenate(parts))) for name, parts in lengths.items()}


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


def _rescaling(camera: RigCamera) -> float | None:
    """How much too small or large K is, if its principal point is off along both axes alike."""
    shares = np.array([(camera.K[0, 2] + 0.5) / camera.width, (camera.K[1, 2] + 0.5) / camera.height])
    off = abs(shares.mean() - 0.5) > CENTRE_LIMIT and abs(shares[0] - shares[1]) < SAME_SHARE
    return float(2 * shares.mean()) if off else None


def _place(camera: RigCamera) -> str:
    return (
        f"principal point at ({camera.K[0, 2]:.0f}, {camera.K[1, 2]:.0f}) of an image of {camera.width}x{camera.height}"
    )


def _resolution(camera: RigCamera) -> str:
    return f"about {2 * camera.K[0, 2]:.0f}x{2 * camera.K[1, 2]:.0f}"
