"""Why no cell looks like a rig, told by the rig's own numbers."""

from __future__ import annotations

import numpy as np

from twin_node.geometry import inverse_pose, transform
from twin_node.rig.calibrate.lenses import in_view
from twin_node.rig.calibrate.mistakes import RATIOS, UNITS_M, Finding, Mistake
from twin_node.rig.rig_checks import OUT_OF_SIGHT, TELLING_SPREAD, aims_off
from twin_node.rig.undistort import Optics
from twin_node.rig.workspace import axes_focus, axes_spread
from twin_node.scene import Float64, Rig, RigCamera

NEAREST_M, FARTHEST_M = 0.04, 12.0
"""No camera of a cell is nearer to, or further from, what all look at."""
NARROWEST, WIDEST = np.radians(12), np.radians(150)
"""Horizontal fields of view of lenses in cells, without distortion."""
CENTRE_SHARE = 0.03
"""A principal point so near, as a share of the image's size, to that of a customary resolution belongs to it."""
LEAST_SEEN = 0.05
"""Share of the workspace that every camera of a rig sees."""
STEPS = np.linspace(0, 1, 6)
GRID = np.stack(np.meshgrid(STEPS, STEPS, STEPS), axis=-1).reshape(-1, 3)
"""[216, 3] shares of a workspace's sides, at which it is looked for in an image."""


class Objections:
    """To many readings of one rig: of what they leave alone, most of it, the answer is remembered."""

    def __init__(self) -> None:
        self._to_lenses: dict[bytes, Finding | None] = {}
        self._to_poses: dict[bytes, Finding | None] = {}
        self._seen_shares: dict[bytes, float] = {}

    def to(self, rig: Rig) -> Finding | None:
        """Why no cell looks like this rig; None where one might."""
        identities = [_identity(camera) for camera in rig.cameras]
        for camera, identity in zip(rig.cameras, identities, strict=True):
            if identity not in self._to_lenses:
                self._to_lenses[identity] = _lens_objection(camera)
            if (finding := self._to_lenses[identity]) is not None:
                return finding
        poses = np.stack([camera.T_base_cam for camera in rig.cameras])
        key = poses.tobytes()
        if key not in self._to_poses:
            self._to_poses[key] = _poses_objection(poses)
        if (finding := self._to_poses[key]) is not None or rig.workspace is None:
            return finding
        for camera, identity in zip(rig.cameras, identities, strict=True):
            seen = identity + camera.T_base_cam.tobytes() + rig.workspace.tobytes()
            if seen not in self._seen_shares:
                self._seen_shares[seen] = _seen_share(camera, rig.workspace)
            if self._seen_shares[seen] < LEAST_SEEN:
                return Finding(camera.name, "it does not see the workspace")
        return None


def view_objection(lens: Optics) -> str | None:
    """What was expected of a lens's horizontal field of view and what was found; None where a cell's may have it."""
    view = 2 * np.arctan(lens.width / 2 / abs(lens.K[0, 0]))
    if lens.distortion_model == "equidistant" or NARROWEST < view < WIDEST:
        return None
    return (
        f"expected a field of view from {np.degrees(NARROWEST):.0f} to {np.degrees(WIDEST):.0f} degrees, found "
        f"{np.degrees(view):.3g}"
    )


def _identity(camera: RigCamera) -> bytes:
    """What tells one camera's lens and name from another's."""
    named = f"{camera.name} {camera.width}x{camera.height} {camera.distortion_model} "
    return named.encode() + camera.K.tobytes() + camera.D.tobytes()


def _poses_objection(poses: Float64) -> Finding | None:
    """Why nobody places cameras at these poses [N, 4, 4]."""
    reach = _reach_m(poses)
    if reach is not None and reach * max(UNITS_M.values()) < NEAREST_M:
        return Finding(
            "",
            "they stand in one place, as where nobody knows their poses: calibrate them together, before a board",
        )
    if reach is not None and not NEAREST_M <= reach <= FARTHEST_M:
        unit = _likely_unit(reach)
        return Finding(
            "",
            f"cameras stand {reach:.3g} m from what they look at: translations seem to be in {unit}: write metres",
            Mistake.UNITS,
        )
    if axes_spread(poses) >= TELLING_SPREAD and aims_off(poses) > OUT_OF_SIGHT:
        return Finding("", "the optical axes do not meet before the cameras")
    return None


def _lens_objection(camera: RigCamera) -> Finding | None:
    centre = (camera.K[:2, 2] + 0.5) / (camera.width, camera.height)
    customary = np.array([1.0, *RATIOS]) / 2
    nearest = customary[np.abs(centre[:, None] - customary).argmin(1)]
    if np.abs(centre - nearest).max() < CENTRE_SHARE and (nearest != 0.5).any():
        size = 2 * centre * (camera.width, camera.height)
        return Finding(
            camera.name,
            f"expected a principal point near the middle of {camera.width}x{camera.height}, found "
            f"({camera.K[0, 2]:.0f}, {camera.K[1, 2]:.0f}); K seems to be of {size[0]:.0f}x{size[1]:.0f}: scale it",
            Mistake.RESOLUTION,
        )
    objection = view_objection(camera)
    return None if objection is None else Finding(camera.name, f"{objection}; is K of another resolution?")


def _reach_m(poses: Float64) -> float | None:
    """Median distance of cameras from the point that all look at, or of each other, m; None for one camera."""
    if len(poses) < 2:
        return None
    middle = axes_focus(poses) if axes_spread(poses) >= TELLING_SPREAD else poses[:, :3, 3].mean(0)
    return float(np.median(np.linalg.norm(poses[:, :3, 3] - middle, axis=1)))


def _likely_unit(reach: float) -> str:
    """The unit in which cameras would be about as far away as they usually are, 1.5 m."""
    return min(UNITS_M, key=lambda unit: abs(np.log(reach * UNITS_M[unit] / 1.5)))


def _seen_share(camera: RigCamera, workspace: Float64) -> float:
    """Share of a workspace [2, 3] that falls into a camera's image."""
    points = transform(inverse_pose(camera.T_base_cam), workspace[0] + GRID * (workspace[1] - workspace[0]))
    return float(in_view(camera, points).mean())
