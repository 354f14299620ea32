"""The customary mistakes in rigs, each undone: what the rig would be had it not been made."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from itertools import combinations

import numpy as np

from twin_node.geometry import inverse_pose
from twin_node.scene import Float64, Rig, RigCamera


class Mistake(Enum):
    """What can be wrong with a rig as a whole or with some of its cameras."""

    UNITS = "units"
    OPENGL = "OpenGL axes"
    TRANSPOSED = "transposed rotation"
    INVERTED = "inverted pose"
    SWAPPED = "swapped cameras"
    MIRRORED = "mirrored"
    RESOLUTION = "K of another resolution"
    BASE = "the controller's base"
    SIZE = "a board of another size"


@dataclass(frozen=True)
class Finding:
    """Something wrong with a rig, in one line."""

    camera: str
    """Its name; several, joined by commas; empty for all."""
    cause: str
    """The likely mistake, and what to do."""
    mistake: Mistake | None = None
    """Its kind; None where no customary one explains what was found."""
    rivals: tuple[Mistake, ...] = ()
    """Other kinds that would explain it as well; `cause` names them too."""

    def __str__(self) -> str:
        return f"camera {self.camera}: {self.cause}" if self.camera else f"all cameras: {self.cause}"


@dataclass(frozen=True)
class Undone:
    """The rig as it would be without a mistake."""

    finding: Finding
    rig: Rig


UNITS_M = {"millimetres": 1e-3, "centimetres": 1e-2, "inches": 0.0254, "feet": 0.3048, "kilometres": 1e3}
"""Length of the units that translations are written in by mistake, m."""

RATIOS = (1 / 3, 1 / 2, 2 / 3, 3 / 4, 4 / 3, 3 / 2, 2.0, 3.0)
"""Of customary resolutions to each other."""


def undone(rig: Rig) -> Iterator[Undone]:
    """The rig with each mistake undone, of all cameras and of each alone."""
    for unit, metres in UNITS_M.items():
        scaled = [_moved(c, _scaled(c.T_base_cam, metres)) for c in rig.cameras]
        yield _all(rig, scaled, f"translations seem to be in {unit}: write metres", Mistake.UNITS)
    turned = [_moved(c, np.diag([-1.0, -1.0, 1.0, 1.0]) @ c.T_base_cam) for c in rig.cameras]
    cause = "poses seem to be in the UR controller's `base`: turn them by 180 degrees about z for `base_link`"
    yield _all(rig, turned, cause, Mistake.BASE)
    yield from _read_otherwise(rig)
    yield from _swapped(rig)
    yield from _rescaled(rig)


def _read_otherwise(rig: Rig) -> Iterator[Undone]:
    """Poses, or images, of another convention."""
    readings = (
        (Mistake.OPENGL, "axes seem to be OpenGL's (z backward): negate columns 2 and 3 of the rotation", _opengl),
        (Mistake.TRANSPOSED, "the rotation seems to be transposed: transpose it, keep the translation", _transposed),
        (Mistake.INVERTED, "the pose seems to be base-to-camera (R, t): invert it", _inverted),
        (Mistake.MIRRORED, "the image seems to be mirrored, left and right swapped: turn mirroring off", _mirrored),
    )
    for mistake, cause, undo in readings:
        yield from _all_or_one(rig, [undo(camera) for camera in rig.cameras], cause, mistake)
    cause = "left and right seem to be swapped, as in left-handed coordinates: negate y of every pose's axes and place"
    yield _all(rig, [_moved(c, _FLIP_Y @ c.T_base_cam @ _FLIP_Y) for c in rig.cameras], cause, Mistake.MIRRORED)


def _swapped(rig: Rig) -> Iterator[Undone]:
    """Two cameras under each other's names, or only their poses."""
    for a, b in combinations(range(len(rig.cameras)), 2):
        first, second = rig.cameras[a], rig.cameras[b]
        names = f"{first.name}, {second.name}"
        poses = {a: _moved(first, second.T_base_cam), b: _moved(second, first.T_base_cam)}
        whole = {a: replace(second, name=first.name), b: replace(first, name=second.name)}
        same_size = (first.width, first.height) == (second.width, second.height)
        for swapped, what in ((poses, "their poses"), (whole, "they"))[: 1 + same_size]:
            cameras = [swapped.get(i, camera) for i, camera in enumerate(rig.cameras)]
            finding = Finding(names, f"{what} seem to be swapped: exchange them", Mistake.SWAPPED)
            yield Undone(finding, replace(rig, cameras=tuple(cameras)))


def _rescaled(rig: Rig) -> Iterator[Undone]:
    """K of another resolution, of all cameras or of one."""
    for ratio in RATIOS:
        scaled = [_resized(camera, ratio) for camera in rig.cameras]
        cause = f"K seems to be of {ratio:.3g} times the image's resolution: scale it"
        yield from _all_or_one(rig, scaled, cause, Mistake.RESOLUTION)


def _all(rig: Rig, cameras: Sequence[RigCamera], cause: str, mistake: Mistake) -> Undone:
    return Undone(Finding("", cause, mistake), replace(rig, cameras=tuple(cameras)))


def _all_or_one(rig: Rig, changed: Sequence[RigCamera], cause: str, mistake: Mistake) -> Iterator[Undone]:
    """All cameras changed, then of several each alone."""
    yield _all(rig, changed, cause, mistake)
    if len(rig.cameras) > 1:
        for i, camera in enumerate(rig.cameras):
            cameras = (*rig.cameras[:i], changed[i], *rig.cameras[i + 1 :])
            yield Undone(Finding(camera.name, cause, mistake), replace(rig, cameras=cameras))


_FLIP_Y = np.diag([1.0, -1.0, 1.0, 1.0])


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


def _opengl(camera: RigCamera) -> RigCamera:
    return _moved(camera, camera.T_base_cam * np.array([1.0, -1.0, -1.0, 1.0]))


def _transposed(camera: RigCamera) -> RigCamera:
    transposed = camera.T_base_cam.copy()
    transposed[:3, :3] = camera.T_base_cam[:3, :3].T
    return _moved(camera, transposed)


def _inverted(camera: RigCamera) -> RigCamera:
    return _moved(camera, inverse_pose(camera.T_base_cam))


def _mirrored(camera: RigCamera) -> RigCamera:
    """The camera of the image as it is without mirroring, seen through mirrored pixels: a focal length below zero."""
    K = camera.K.copy()
    K[0, 0] *= -1
    K[0, 2] = camera.width - 1 - K[0, 2]
    return replace(camera, K=K)


def _moved(camera: RigCamera, T_base_cam: Float64) -> RigCamera:
    return replace(camera, T_base_cam=T_base_cam)
