"""The pictures of a calibration's page: the rig from three sides, its links, residuals and coverage."""

from __future__ import annotations

import base64
import io
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from twin_node.geometry import transform
from twin_node.rig.calibrate.lenses import homogeneous, pixel_rays
from twin_node.rig.calibrate.rig_fit import RigFit
from twin_node.rig.rig_file import RigFile
from twin_node.scene import Float64, Rig, RigCamera

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DRAWN_SHARE = 0.18
"""Length of a drawn camera's pyramid as a share of the rig's size."""
MOST_REACH = 2.0
"""How many of these lengths a drawn camera's corners are from it at most: a fisheye's lie beside it, with no end."""
ARROW_SHARE = 0.04
"""Length at which the 95th percentile of the residuals is drawn, as a share of the image's width."""
ELLIPSE_SHARE = 0.06
"""Size at which the largest ellipsoid is drawn, as a share of the rig's; all are enlarged alike."""
ELLIPSE_SIGMAS = 3.368
"""Radius of a 99 % ellipsoid in three dimensions, in sigmas (chi-square with three degrees of freedom)."""
SINGLE_CAMERA_SIZE_M = 1.0
"""Size of the drawing of a rig of one camera, which has none."""
OBLIQUE_ZOOM, OBLIQUE_TICKS = 0.8, 5
"""Size of the oblique drawing as a share of Matplotlib's own, whose numbers lie upon what is beside it, and about how
many numbers an axis has: along a short one more would lie upon each other. The vertical axis has no name, for which
there is no room."""
HEAT_CELLS = 16
"""Cells across an image in which corners are counted."""
GHOST = "#9aa0a6"
"""Colour of the rig as it was before."""


@dataclass(frozen=True)
class Picture:
    """A drawing of the page."""

    title: str
    caption: str
    png: str
    """In base64."""


def draw_rig(rig_file: RigFile, before: Rig | None) -> Picture:
    """Cameras as pyramids, obliquely, from above and from the side; the rig as it was `before` in grey."""
    figure = _figure(13, 4.6)
    size = _size(rig_file.rig)
    oblique = figure.add_subplot(1, 3, 1, projection="3d")
    for number, camera in enumerate(rig_file.rig.cameras):
        lines = _outline(camera, DRAWN_SHARE * size)
        oblique.plot(*lines.T, color=f"C{number}", linewidth=1)
        oblique.text(*camera.T_base_cam[:3, 3], f" {camera.name}", color=f"C{number}", fontsize=8)
    oblique.set(xlabel="x (m)", ylabel="y (m)", title="obliquely, z up")
    oblique.tick_params(labelsize=7)
    oblique.locator_params(nbins=OBLIQUE_TICKS)
    sides = np.ptp([oblique.get_xlim(), oblique.get_ylim(), oblique.get_zlim()], axis=1)
    oblique.set_box_aspect(sides, zoom=OBLIQUE_ZOOM)  # all to one scale
    enlarged = _ellipse_scale(rig_file, size)
    for place, (across, up, title) in enumerate(((0, 1, "from above"), (0, 2, "from the side")), start=2):
        axes = figure.add_subplot(1, 3, place)
        for camera in before.cameras if before is not None else ():
            axes.plot(*_outline(camera, DRAWN_SHARE * size)[:, [across, up]].T, color=GHOST, linewidth=0.8)
        for number, camera in enumerate(rig_file.rig.cameras):
            axes.plot(*_outline(camera, DRAWN_SHARE * size)[:, [across, up]].T, color=f"C{number}", linewidth=1)
            _draw_ellipse(axes, rig_file, number, (across, up), enlarged)
        if rig_file.rig.workspace is not None:
            _draw_box(axes, rig_file.rig.workspace[:, [across, up]])
        axes.set(xlabel="xyz"[across] + " (m)", ylabel="xyz"[up] + " (m)", title=title)
        axes.set_aspect("equal", adjustable="datalim")
        axes.grid(alpha=0.3)
    caption = f"Cameras and what they look at, in {rig_file.frame}."
    if enlarged:
        caption += f" Ellipses: where a camera stands with 99 % probability, {enlarged:.0f} times enlarged."
    return _picture("The rig", caption + (" Grey: the rig before." if before is not None else ""), figure)


def draw_links(rig: Rig, fit: RigFit) -> Picture:
    """Which cameras saw the board at once, how often: what holds the rig together."""
    figure = _figure(7, 4)
    axes = figure.add_subplot()
    centres = np.stack([camera.T_base_cam[:2, 3] for camera in rig.cameras])
    seen = [{s.board for s in fit.sightings if s.camera == number} for number in range(len(rig.cameras))]
    shared = {(a, b): len(seen[a] & seen[b]) for a, b in combinations(range(len(seen)), 2)}
    most = max(shared.values(), default=1) or 1
    for (a, b), count in shared.items():
        if count:
            axes.plot(*centres[[a, b]].T, color="#5f6368", linewidth=0.5 + 4 * count / most, zorder=1)
            axes.annotate(str(count), centres[[a, b]].mean(axis=0), backgroundcolor="white", fontsize=8)
    for number, camera in enumerate(rig.cameras):
        axes.plot(*centres[number], "o", color=f"C{number}", markersize=12, zorder=2)
        axes.annotate(camera.name, centres[number], xytext=(8, 8), textcoords="offset points")
    axes.set(xlabel="x (m)", ylabel="y (m)")
    axes.set_aspect("equal", adjustable="datalim")
    axes.margins(0.2)
    return _picture("Links", "Sets in which two cameras saw the board at once, from above.", figure)


def draw_residuals(rig: Rig, fit: RigFit, before: RigFit | None) -> Picture:
    """Where each camera's corners are off, and by how much; those of the rig before in grey."""
    figure = _figure(11, 3.2 * len(rig.cameras))
    lengths = np.linalg.norm(np.concatenate(fit.residuals), axis=1)
    scale = ARROW_SHARE * max(camera.width for camera in rig.cameras) / max(float(np.percentile(lengths, 95)), 1e-9)
    for number, camera in enumerate(rig.cameras):
        where = _image_axes(figure, camera, (len(rig.cameras), 2, 2 * number + 1))
        how = figure.add_subplot(len(rig.cameras), 2, 2 * number + 2)
        older = None if before is None else before.of_camera(number)
        if older is not None:
            how.plot(*older.T, ".", markersize=2, color=GHOST, alpha=0.5)
        if (vectors := fit.of_camera(number)) is not None:
            pixels = np.concatenate(pixels_of(fit, number))
            where.quiver(*pixels.T, *(scale * vectors).T, angles="xy", scale_units="xy", scale=1, width=0.002)
            how.plot(*vectors.T, ".", markersize=2, alpha=0.4, color=f"C{number}")
            drawn = vectors if older is None else np.concatenate([vectors, older])
            reach = float(np.percentile(np.abs(drawn), 99)) * 1.2
            how.set(xlim=(-reach, reach), ylim=(reach, -reach), aspect="equal")
        how.set(title=f"{camera.name}: found minus projected (px)")
        how.grid(alpha=0.3)
    caption = (
        f"Left: over the image, {scale:.0f} times as long as they are. Measured against the board as it was "
        "given: where the calibration refined its shape, what the rig file states is smaller."
    )
    return _picture("Residuals", caption + (" Grey: the rig before." if before is not None else ""), figure)


def draw_coverage(rig: Rig, fit: RigFit) -> Picture:
    """How many corners each part of the images has."""
    columns = min(len(rig.cameras), 3)
    rows = -(-len(rig.cameras) // columns)
    figure = _figure(11, 3.0 * rows)
    for number, camera in enumerate(rig.cameras):
        axes = _image_axes(figure, camera, (rows, columns, number + 1))
        own = pixels_of(fit, number)
        pixels = np.concatenate(own) if own else np.zeros((0, 2))
        down = max(round(HEAT_CELLS * camera.height / camera.width), 1)
        across, along = (
            np.linspace(-0.5, size - 0.5, n + 1) for size, n in ((camera.width, HEAT_CELLS), (camera.height, down))
        )
        counts, *_ = np.histogram2d(pixels[:, 0], pixels[:, 1], bins=[across, along])
        shown = np.ma.masked_equal(counts.T, 0)
        heat = axes.imshow(shown, extent=(-0.5, camera.width - 0.5, camera.height - 0.5, -0.5), cmap="viridis")
        figure.colorbar(heat, ax=axes, shrink=0.8)
    return _picture("Coverage", "Corners per part of the image. White: none; the lens is extrapolated there.", figure)


def pixels_of(fit: RigFit, camera: int) -> list[Float64]:
    """Per sighting of a camera: [N, 2] where its corners were found."""
    return [sighting.corners.pixels for sighting in fit.sightings if sighting.camera == camera]


def _size(rig: Rig) -> float:
    centres = np.stack([camera.T_base_cam[:3, 3] for camera in rig.cameras])
    return float(np.ptp(centres, axis=0).max()) or SINGLE_CAMERA_SIZE_M


def _outline(camera: RigCamera, length: float) -> Float64:
    """[L, 3] one line along the pyramid from the centre to the image, `length` metres before it, in the base frame.

    Where that is too far aside the corner is nearer, on its ray.
    """
    width, height = camera.width - 1.0, camera.height - 1.0
    rays = homogeneous(pixel_rays(camera, np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]])))
    rays *= np.minimum(MOST_REACH / np.linalg.norm(rays, axis=1, keepdims=True), 1.0)
    a, b, c, d = transform(camera.T_base_cam, rays * length)
    centre = camera.T_base_cam[:3, 3]
    return np.stack([centre, a, b, centre, c, d, centre, b, c, d, a])


def _covariance(rig_file: RigFile, number: int) -> Float64 | None:
    """[3, 3] of a camera's place, m^2; None where the file does not tell or takes it for exact."""
    evidence = rig_file.evidence[number] if rig_file.evidence else None
    if evidence is None or evidence.pose_covariance is None or not evidence.pose_covariance.any():
        return None
    return evidence.pose_covariance[:3, :3]


def _ellipse_scale(rig_file: RigFile, size: float) -> float:
    """How many times ellipses are enlarged; 0 where there are none."""
    known = [_covariance(rig_file, number) for number in range(len(rig_file.rig.cameras))]
    largest = max((float(np.linalg.eigvalsh(c)[-1]) for c in known if c is not None), default=0.0)
    return ELLIPSE_SHARE * size / (ELLIPSE_SIGMAS * np.sqrt(largest)) if largest > 0 else 0.0


def _draw_ellipse(axes: Axes, rig_file: RigFile, number: int, sides: Sequence[int], enlarged: float) -> None:
    covariance = _covariance(rig_file, number)
    if covariance is None:
        return
    values, vectors = np.linalg.eigh(covariance[np.ix_(sides, sides)])
    angles = np.linspace(0, 2 * np.pi, 64)
    circle = np.stack([np.cos(angles), np.sin(angles)])
    ellipse = (vectors * np.sqrt(np.maximum(values, 0))) @ circle * ELLIPSE_SIGMAS * enlarged
    centre = rig_file.rig.cameras[number].T_base_cam[list(sides), 3]
    axes.fill(*(centre[:, None] + ellipse), color=f"C{number}", alpha=0.35)


def _draw_box(axes: Axes, corners: Float64) -> None:
    (left, low), (right, high) = corners
    axes.plot([left, right, right, left, left], [low, low, high, high, low], color="#34a853", linewidth=0.8)


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
