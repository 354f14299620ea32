"""A calibration as one HTML page: its cameras in a table, its rig, links, residuals and coverage as pictures."""

from __future__ import annotations

import base64
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import jinja2

from twin_node.rig.calibrate import report_pictures as pictures
from twin_node.rig.calibrate.results import residuals_of
from twin_node.rig.calibrate.rig_fit import RigFit
from twin_node.rig.errors import RigError
from twin_node.rig.rig_file import RigFile
from twin_node.unfinished import unwritable, whole_file

TEMPLATE = Path(__file__).with_name("report.html")


@dataclass(frozen=True)
class Calibration:
    """A rig and, where there are recordings of a board, its residuals on them."""

    rig_file: RigFile
    fit: RigFit | None = None


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
    before: str
    """Median and rms under the rig before; empty without one."""


def write_report(
    calibration: Calibration, name: str, path: Path, before: Calibration | None = None
) -> tuple[pictures.Picture, ...]:
    """Writes the page of a rig and returns its pictures; without residuals only the rig is drawn.

    `before`: an earlier rig of the same cameras. Raises `RigError` where it is of others, or the page not writable.
    """
    rig_file, fit = calibration.rig_file, calibration.fit
    if before is not None:
        _check_same(rig_file, before.rig_file)
    drawn = [pictures.draw_rig(rig_file, None if before is None else before.rig_file.rig)]
    if fit is not None:
        older = None if before is None else before.fit
        drawn += [
            pictures.draw_links(rig_file.rig, fit),
            pictures.draw_residuals(rig_file.rig, fit, older),
            pictures.draw_coverage(rig_file.rig, fit),
        ]
    template = jinja2.Template(TEMPLATE.read_text(encoding="utf-8"), autoescape=True, trim_blocks=True)
    page = template.render(
        name=name,
        frame=rig_file.frame,
        date=rig_file.date,
        board=rig_file.board,
        notes=rig_file.notes,
        has_before=before is not None,
        cameras=[_row(calibration, number, before) for number in range(len(rig_file.rig.cameras))],
        pictures=drawn,
    )
    with whole_file(path, RigError) as partial:
        partial.write_text(page, encoding="utf-8")
    return tuple(drawn)


def save_pictures(drawn: Sequence[pictures.Picture], folder: Path) -> None:
    """Each picture of a page as a PNG file named after its title. Raises `RigError` where they cannot be written."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RigError(unwritable(folder, error)) from None
    for picture in drawn:
        with whole_file(folder / f"{picture.title.lower().replace(' ', '_')}.png", RigError) as partial:
            partial.write_bytes(base64.b64decode(picture.png))


def _check_same(rig_file: RigFile, before: RigFile) -> None:
    ours, theirs = ([camera.name for camera in one.rig.cameras] for one in (rig_file, before))
    if ours != theirs:
        raise RigError(
            f"report: expected the rig before to have the cameras {', '.join(ours)}, found {', '.join(theirs)}; give "
            "an earlier file of the same rig"
        )


def _row(calibration: Calibration, number: int, before: Calibration | None) -> CameraRow:
    camera = calibration.rig_file.rig.cameras[number]
    evidence = calibration.rig_file.evidence[number] if calibration.rig_file.evidence else None
    views = "-" if evidence is None or not evidence.views else str(evidence.views)
    if calibration.fit is not None:
        views = str(len(pictures.pixels_of(calibration.fit, number)))
    figures = _figures(calibration, number)
    older = None if before is None else _figures(before, number)
    return CameraRow(
        camera.name,
        f"{camera.width}x{camera.height}",
        f"{camera.K[0, 0]:.1f}, {camera.K[1, 1]:.1f}",
        ", ".join(f"{value:.3f}" for value in camera.T_base_cam[:3, 3]),
        f"{1e3 * camera.sigma_m:.2f}" if camera.sigma_m else "unknown",
        f"{camera.time_offset_ns / 1e6:+.1f}",
        views,
        "-" if figures is None else f"{figures.median_px:.3f}",
        "-" if figures is None else f"{figures.rms_px:.3f}",
        "-" if older is None else f"{older.median_px:.3f} / {older.rms_px:.3f}",
    )


@dataclass(frozen=True)
class _Figures:
    """Lengths of residuals, pixels."""

    median_px: float
    rms_px: float


def _figures(calibration: Calibration, number: int) -> _Figures | None:
    """A camera's residuals: on the recordings where there are some, else what the rig file says of its calibration."""
    if calibration.fit is not None:
        own = calibration.fit.of_camera(number)
        if own is None:
            return None
        residuals = residuals_of(own)
        return _Figures(residuals.median_px, residuals.rms_px)
    evidence = calibration.rig_file.evidence[number] if calibration.rig_file.evidence else None
    if evidence is None or evidence.median_px is None or evidence.rms_px is None:
        return None
    return _Figures(evidence.median_px, evidence.rms_px)
