"""A calibration as one HTML page: its cameras in a table and in space, its residuals and its coverage as pictures."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import jinja2
import numpy as np

from twin_node.geometry import transform
from twin_node.rig.calibrate.lenses import lens_of, rays_of
from twin_node.rig.calibrate.results import residuals_of
from twin_node.rig.calibrate.rig_fit import RigFit
from twin_node.rig.rig_file import RigFile
from twin_node.scene import Float64, Rig, RigCamera

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

TEMPLATE = Path(__file__).with_name("report.html")

DRAWN_SHARE = 0.18
"""Length of a drawn camera's pyramid as a share of the rig's size."""

ARROW_SCALE = 50.0
"""Residuals are drawn so many times as long as they are."""

SINGLE_CAMERA_SIZE_M = 1.0
"""Size of the drawing of a rig of one camera, which has none."""


@dataclass(frozen=True)
class Picture:
    """A drawing of the page."""

    title: str
    caption: str
    png: str
    """In base64."""


@dataclass(frozen=True)
class CameraRow:
    """A camera's line of the table, as text."""

    name: str
    size: str
    focal: str
    position: str
    sigma: str
    clock: str
    views: str
    median: str
    rms: str


def write_report(rig_file: RigFile, fit: RigFit | None, name: str, path: Path) -> None:
    """Writes the page of a rig; `fit`: its residuals on recordings of a board, without which only the rig is drawn."""
    pictures = [_draw_rig(rig_file)]
    if fit is not None:
        pictures += [_draw_residuals(rig_file.rig, fit), _draw_coverage(rig_file.rig, fit)]
    template = jinja2.Template(TEMPLATE.read_text(encoding="utf-8"), autoescape=True, trim_blocks=True)
    page = template.render(
        name=name,
        frame=rig_file.frame,
        date=rig_file.date,
        board=rig_file.board,
        notes=rig_file.notes,
        cameras=[_row(rig_file, number, fit) for number in range(len(rig_file.rig.cameras))],
        pictures=pictures,
    )
    path.write_text(page, encoding="utf-8")


def _row(rig_file: RigFile, number: int, fit: RigFit | None) -> CameraRow:
    camera = rig_file.rig.cameras[number]
    evidence = rig_file.evidence[number] if rig_file.evidence else None
    views, median, rms = ("-", "-", "-")
    if evidence is not None and evidence.rms_px is not None:
        views, median, rms = str(evidence.views), f"{evidence.median_px:.3f}", f"{evidence.rms_px:.3f}"
    if fit is not None and (own := fit.of_camera(number)) is not None:
        figures = residuals_of(own)
        views, median, rms = str(len(_pixels(fit, number))), f"{figures.median_px:.3f}", f"{figures.rms_px:.3f}"
    return CameraRow(
        camera.name,
        f"{camera.width}x{camera.height}",
        f"{camera.K[0, 0]:.1f}, {camera.K[1, 1]:.1f}",
        ", ".join(f"{value:.3f}" for value in camera.T_base_cam[:3, 3]),
        f"{1e3 * camera.sigma_m:.2f}" if camera.sigma_m else "unknown",
        f"{camera.time_offset_ns / 1e6:+.1f}",
        views,
        median,
        rms,
    )


def _pixels(fit: RigFit, camera: int) -> list[Float64]:
    return [sighting.corners.pixels for sighting in fit.sightings if sighting.camera == camera]


def _draw_rig(rig_file: RigFile) -> Picture:
    """Cameras as pyramids, seen obliquely."""
    figure = _figure(9, 7)
    axes = figure.add_subplot(projection="3d")
    cameras = rig_file.rig.cameras
    centres = np.stack([camera.T_base_cam[:3, 3] for camera in cameras])
    length = DRAWN_SHARE * (float(np.ptp(centres, axis=0).max()) or SINGLE_CAMERA_SIZE_M)
    drawn = [centres]
    for number, camera in enumerate(cameras):
        corners, colour = _pyramid(camera, length), f"C{number}"
        for corner in corners:
            axes.plot(*np.stack([centres[number], corner]).T, color=colour, linewidth=1)
        axes.plot(*np.concatenate([corners, corners[:1]]).T, color=colour, linewidth=1)
        axes.text(*centres[number], f" {camera.name}", color=colour)
        drawn.append(corners)
    if rig_file.rig.workspace is not None:
        drawn.append(rig_file.rig.workspace)
    points = np.concatenate(drawn)
    middle, half = (points.max(0) + points.min(0)) / 2, float(np.ptp(points, axis=0).max()) / 2
    for axis, centre in zip("xyz", middle, strict=True):
        getattr(axes, f"set_{axis}lim")(centre - half, centre + half)
        getattr(axes, f"set_{axis}label")(f"{axis} (m)")
    return _picture("The rig", f"Cameras and what they look at, in {rig_file.frame}.", figure)


def _pyramid(camera: RigCamera, length: float) -> Float64:
    """Corners [4, 3] of the image, `length` metres in front of the camera, in the base frame."""
    width, height = camera.width - 1.0, camera.height - 1.0
    rays = rays_of(lens_of(camera), np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]]))
    return transform(camera.T_base_cam, np.concatenate([rays, np.ones((4, 1))], axis=1) * length)


def _draw_residuals(rig: Rig, fit: RigFit) -> Picture:
    """Where each camera's corners are off, and by how much."""
    figure = _figure(11, 3.2 * len(rig.cameras))
    for number, camera in enumerate(rig.cameras):
        where = _image_axes(figure, camera, (len(rig.cameras), 2, 2 * number + 1))
        how = figure.add_subplot(len(rig.cameras), 2, 2 * number + 2)
        if (vectors := fit.of_camera(number)) is not None:
            pixels = np.concatenate(_pixels(fit, number))
            where.quiver(*pixels.T, *(ARROW_SCALE * vectors).T, angles="xy", scale_units="xy", scale=1, width=0.002)
            how.plot(*vectors.T, ".", markersize=2, alpha=0.4)
            reach = float(np.percentile(np.abs(vectors), 99)) * 1.2
            how.set(xlim=(-reach, reach), ylim=(reach, -reach), aspect="equal")
        how.set(title=f"{camera.name}: found minus projected (px)")
        how.grid(alpha=0.3)
    return _picture("Residuals", f"Left: over the image, {ARROW_SCALE:.0f} times as long as they are.", figure)


def _draw_coverage(rig: Rig, fit: RigFit) -> Picture:
    """Which parts of the images have corners."""
    columns = min(len(rig.cameras), 3)
    rows = -(-len(rig.cameras) // columns)
    figure = _figure(11, 3.0 * rows)
    for number, camera in enumerate(rig.cameras):
        axes = _image_axes(figure, camera, (rows, columns, number + 1))
        if own := _pixels(fit, number):
            axes.plot(*np.concatenate(own).T, ".", markersize=2, alpha=0.5)
    return _picture("Coverage", "Corners found. Where an image has none, its lens is extrapolated.", figure)


def _image_axes(figure: Figure, camera: RigCamera, place: tuple[int, ...]) -> Axes:
    axes = figure.add_subplot(*place)
    axes.set(xlim=(0, camera.width), ylim=(camera.height, 0), aspect="equal", title=camera.name)
    return axes


def _figure(width: float, height: float) -> Figure:
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), dpi=100, layout="constrained")


def _picture(title: str, caption: str, figure: Figure) -> Picture:
    buffer = io.BytesIO()
    figure.savefig(buffer, format="png")
    return Picture(title, caption, base64.b64encode(buffer.getvalue()).decode("ascii"))
