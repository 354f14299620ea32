"""How well a calibration determines a camera, as rig files keep it."""

from __future__ import annotations

import dataclasses
from dataclasses import dataclass

import numpy as np

from twin_node.rig.errors import RigError
from twin_node.rig.yaml_fields import Fields
from twin_node.scene import Float64

LEAST_SIGMAS = 4
"""Of a lens: fx, fy, cx, cy; each distortion coefficient has one more."""


@dataclass(frozen=True)
class CameraEvidence:
    """What a calibration left over at one camera, and how sure it is of it."""

    rms_px: float | None = None
    """Root mean square distance between what was found and what is projected, pixels; None where no board was used."""
    median_px: float | None = None
    views: int = 0
    """Images used; 0 where that is not known."""
    corners: int = 0
    """Points used in all of them; 0 where that is not known."""
    pose_covariance: Float64 | None = None
    """[6, 6] of `T_base_cam`: x, y, z (m), then turns about the base's x, y, z (rad), as in
    geometry_msgs/PoseWithCovariance; without what moves the rig as a whole. None where unknown."""
    lens_sigmas: Float64 | None = None
    """[4 + D] 1 sigma of fx, fy, cx, cy (pixels) and the distortion coefficients; None where unknown."""
    time_offset_sigma: float | None = None
    """1 sigma of the clock offset, s; None where it was not estimated."""
    time_rate_sigma_ppm: float | None = None
    """1 sigma of the clock's rate, parts per million; None where it was not estimated."""


def read_evidence(fields: Fields) -> CameraEvidence:
    """The field `evidence` of a camera. Raises `RigError` for wrong values."""
    fields.only(*(field.name for field in dataclasses.fields(CameraEvidence)))
    covariance = fields.array("pose_covariance", (6, 6)) if fields.has("pose_covariance") else None
    if covariance is not None and not np.allclose(covariance, covariance.T, rtol=1e-3, atol=1e-12):
        raise RigError(f"{fields.where}.pose_covariance: expected a symmetric matrix, found another; copy it whole")
    lens_sigmas = fields.array("lens_sigmas", None) if fields.has("lens_sigmas") else None
    if lens_sigmas is not None and (len(lens_sigmas) < LEAST_SIGMAS or (lens_sigmas < 0).any()):
        raise RigError(
            f"{fields.where}.lens_sigmas: expected 1 sigma of fx, fy, cx, cy and each distortion coefficient, none "
            f"below 0, found {lens_sigmas.tolist()}; copy it whole"
        )
    return CameraEvidence(
        fields.number("rms_px") if fields.has("rms_px") else None,
        fields.number("median_px") if fields.has("median_px") else None,
        int(fields.number("views", 0)),
        int(fields.number("corners", 0)),
        covariance,
        lens_sigmas,
        fields.number("time_offset_sigma") if fields.has("time_offset_sigma") else None,
        fields.number("time_rate_sigma_ppm") if fields.has("time_rate_sigma_ppm") else None,
    )


def evidence_entry(evidence: CameraEvidence) -> dict[str, object]:
    """What `read_evidence` reads back."""
    entry: dict[str, object] = {}
    for field in dataclasses.fields(evidence):
        value = getattr(evidence, field.name)
        if value is not None and not (field.default == 0 and value == 0):
            entry[field.name] = value.tolist() if isinstance(value, np.ndarray) else value
    return entry
