"""What a better rig is worth: how well a static model of all cameras but one shows what that one sees.

For a rig and every camera left out in turn, the median images of the other cameras colour Gaussians on the plane that
most of the views show (the table), and these are rendered in the camera left out. PSNR counts where images stand still
and at least two of the model's cameras see the plane. Polished tables shine differently into every camera, by more than
a rig's errors show; so PSNR is also given after one gain and offset per channel, and after gains and offsets that vary
smoothly (quadratically) over the image, each fitted to the same pixels.
"""

from __future__ import annotations

import statistics
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from twin_node.bench.errors import BenchError
from twin_node.bench.flat_model import FlatModel
from twin_node.model.features import triangulate
from twin_node.model.plane import Plane, dominant_plane
from twin_node.model.quality import psnr
from twin_node.model.rays import back_project, look
from twin_node.nodes.log_source import LogSession, LogSource
from twin_node.nodes.synchronizer import SynchronizerParameters
from twin_node.rig import Undistorter, workspace_of
from twin_node.rig.calibrate.stills import Still, stills_of
from twin_node.rig.undistort import without_distortion
from twin_node.scene import Bool, Camera, Float32, Float64, Rig, View

STILLS_RATE_HZ = 4.0
"""Sets per second that the median images are taken of."""
STANDING_LEVEL = 250
"""A pixel stands still where, scaled down, all that it is made of does (8-bit levels)."""
LEAST_SEEN_BY = 2
"""Cameras of the model that must see a surface for it to count."""
LATTICE_PX = 1.0
"""Spacing of the model's Gaussians in pixels of the nearest view; finer lattices, of 0.5 and 0.7, show no more."""
LEAST_PIXELS = 500
"""Pixels below which a camera left out is not scored."""


@dataclass(frozen=True)
class RefinedParameters:
    """How models are trained."""

    width: int = 240
    """Of all images, pixels."""
    steps: int = 200
    """Of gradient descent."""


@dataclass(frozen=True)
class LeftOutScore:
    """A camera that the model did not see: PSNR in dB."""

    psnr_db: float
    """As rendered."""
    one_gain_psnr_db: float
    """After one gain and offset per channel."""
    shading_psnr_db: float
    """After gains and offsets that vary quadratically over the image."""
    pixels: int
    """That count."""


@dataclass(frozen=True)
class RefinedBench:
    """Two rigs on one recording."""

    before: dict[str, LeftOutScore]
    """By camera left out."""
    after: dict[str, LeftOutScore]

    def gain_db(self, of: Callable[[LeftOutScore], float]) -> float:
        """Mean over the cameras of what the second rig adds to one of their figures, dB."""
        return statistics.mean(of(self.after[name]) - of(self.before[name]) for name in self.before)

    def as_json(self) -> dict[str, Any]:
        """Under stable names."""
        return {
            "gain_db": self.gain_db(lambda score: score.psnr_db),
            "one_gain_gain_db": self.gain_db(lambda score: score.one_gain_psnr_db),
            "shading_gain_db": self.gain_db(lambda score: score.shading_psnr_db),
            "before": {name: asdict(score) for name, score in self.before.items()},
            "after": {name: asdict(score) for name, score in self.after.items()},
        }


def run(
    log: Path, before: Rig, after: Rig, parameters: RefinedParameters, step: Callable[[], object] = lambda: None
) -> RefinedBench:
    """Scores two rigs of the same cameras on what stands still in a log; `step()` is called after every model.

    Raises `BenchError` where the rigs differ in their cameras or have fewer than three.
    """
    names = [camera.name for camera in before.cameras]
    if names != [camera.name for camera in after.cameras]:
        found = ", ".join(camera.name for camera in after.cameras)
        raise BenchError(
            f"bench refined: expected two rigs of the cameras {', '.join(names)}, found {found} in the other"
        )
    if len(names) < 3:
        raise BenchError(f"bench refined: expected three cameras or more to leave one out of, found {len(names)}")
    stills = _stills(log, before)
    return RefinedBench(*(score_rig(rig, stills, parameters, step) for rig in (before, after)))


def _stills(log: Path, rig: Rig) -> tuple[Still, ...]:
    """What stands still, in raw pixels: the log is read as if lenses had no distortion."""
    with LogSession(log, without_distortion(rig)) as session:
        return stills_of(rig, LogSource(session, SynchronizerParameters(max_rate_hz=STILLS_RATE_HZ)))


def score_rig(
    rig: Rig, stills: Sequence[Still], parameters: RefinedParameters, step: Callable[[], object]
) -> dict[str, LeftOutScore]:
    """By camera left out, how well a model of the others shows its still image.

    Raises `BenchError` where no plane is found, or too little of it is in sight of all.
    """
    undistorters = [Undistorter(camera, parameters.width) for camera in rig.cameras]
    views = [undistorter.view(0, still.rgb) for undistorter, still in zip(undistorters, stills, strict=True)]
    standing = [_standing(undistorter, still) for undistorter, still in zip(undistorters, stills, strict=True)]
    plane = dominant_plane(views, triangulate(views))
    if plane is None:
        raise BenchError("bench refined: expected a table or floor that all cameras show, found no common plane")
    workspace = workspace_of([view.camera for view in views]) if rig.workspace is None else rig.workspace
    on_plane = [_where_on_plane(view.camera, plane, workspace) for view in views]
    scores = {}
    for i, hidden in enumerate(views):
        shown = [j for j in range(len(views)) if j != i]
        model = FlatModel(plane, workspace[:, :2], LATTICE_PX * _pixel_m(views, plane))
        model.fit([views[j] for j in shown], [standing[j] & on_plane[j] for j in shown], parameters.steps)
        seen_by = sum(_seen(hidden.camera, plane, views[j].camera, standing[j]).astype(np.int64) for j in shown)
        counted = standing[i] & on_plane[i] & (seen_by >= LEAST_SEEN_BY)
        if counted.sum() < LEAST_PIXELS:
            raise BenchError(
                f"bench refined: camera {hidden.camera.name}: expected {LEAST_PIXELS} pixels that two other cameras "
                f"see too, found {counted.sum()}; this rig's cameras share too little"
            )
        scores[hidden.camera.name] = _score(model.render(hidden.camera), (hidden.rgb / 255).astype(np.float32), counted)
        step()
    return scores


def _standing(undistorter: Undistorter, still: Still) -> Bool:
    """[H, W] pixels of the undistorted image that stand still and are of the image."""
    levels = undistorter.view(0, np.repeat(still.still[..., None], 3, axis=2).astype(np.uint8) * 255)
    standing = levels.rgb[..., 0] > STANDING_LEVEL
    return standing if levels.valid is None else standing & levels.valid


def _points(camera: Camera, plane: Plane) -> Float64:
    """[H, W, 3] where the pixels' rays meet the plane, m; not finite where they do not."""
    return back_project(camera, plane.depth(camera)).reshape(camera.height, camera.width, 3)


def _where_on_plane(camera: Camera, plane: Plane, workspace: Float64) -> Bool:
    """[H, W] pixels whose rays meet the plane within the workspace's sides."""
    x, y = np.moveaxis(_points(camera, plane)[..., :2], -1, 0)
    (left, near), (right, far) = workspace[:, :2]
    return np.asarray((x > left) & (x < right) & (y > near) & (y < far))


def _seen(camera: Camera, plane: Plane, other: Camera, standing: Bool) -> Bool:
    """[H, W] pixels of a camera whose point on the plane is in a standing pixel of another."""
    points = np.nan_to_num(_points(camera, plane), nan=1e6, posinf=1e6, neginf=-1e6)
    at = look(other, points.reshape(-1, 3))
    return (at.inside & at.within(standing)).reshape(camera.height, camera.width)


def _pixel_m(views: Sequence[View], plane: Plane) -> float:
    """Side of the finest pixels on the plane along each view's axis, m: the model's resolution."""
    sides = []
    for view in views:
        depth = plane.depth(view.camera)[view.camera.height // 2, view.camera.width // 2]
        sides.append(float(depth) / view.camera.K[0, 0])
    return float(min(sides))


def _score(rendered: Float32, seen: Float32, counted: Bool) -> LeftOutScore:
    """Of images [H, W, 3] in 0 to 1, in the pixels counted [H, W]."""
    height, width = counted.shape
    y, x = (np.nonzero(counted)[i] / width - (height, width)[i] / (2 * width) for i in (0, 1))
    ones = np.ones_like(x)
    constant, quadratic = ones[:, None], np.column_stack([ones, x, y, x * x, x * y, y * y])
    a, b = rendered[counted].astype(np.float64), seen[counted].astype(np.float64)
    return LeftOutScore(
        psnr_db=psnr(float(((a - b) ** 2).mean())),
        one_gain_psnr_db=psnr(_error(a, b, constant)),
        shading_psnr_db=psnr(_error(a, b, quadratic)),
        pixels=len(a),
    )


def _error(rendered: Float64, seen: Float64, fields: Float64) -> float:
    """Mean squared error once gain and offset, both combinations of `fields` [n, F], are fitted per channel."""
    errors = []
    for a, b in zip(rendered.T, seen.T, strict=True):
        terms = np.column_stack([fields * a[:, None], fields])
        errors.append(float(((terms @ np.linalg.lstsq(terms, b, rcond=None)[0] - b) ** 2).mean()))
    return float(np.mean(errors))
