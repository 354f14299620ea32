"""The refined rig of the real recording: all cameras see the holes of the table at the same places."""

from __future__ import annotations

from itertools import combinations
from pathlib import Path

import cv2
import numpy as np
import pytest
from scipy.ndimage import gaussian_filter, minimum_filter
from scipy.spatial import KDTree

from twin_node.rig import DecodedImage, FrameAssembler, load_rig
from twin_node.scene import Float64, View

PROJECT = Path(__file__).resolve().parents[2]
RECORDING = PROJECT.parent / "shared" / "data" / "pusht_3cam"
TABLE = np.array([-0.0091, -0.0004, 1.0, 0.0011])
"""Plane n . x + d = 0 of the table top in `base_link`."""


def holes(view: View) -> Float64:
    """Pixels [N, 2] (gsplat's convention) of small dark spots, to a fraction of a pixel."""
    grey = view.rgb.mean(axis=2)
    around = gaussian_filter(grey, 6)
    contrast = gaussian_filter((grey - around) / (around + 10), 1.0)
    v, u = np.nonzero((contrast == minimum_filter(contrast, 7)) & (contrast < -0.15))
    inner = (u > 2) & (v > 2) & (u < contrast.shape[1] - 3) & (v < contrast.shape[0] - 3)
    u, v = u[inner], v[inner]
    shift = []
    for before, after in ((contrast[v, u - 1], contrast[v, u + 1]), (contrast[v - 1, u], contrast[v + 1, u])):
        curvature = before + after - 2 * contrast[v, u]
        shift.append((before - after) / (2 * np.maximum(curvature, 1e-6)))
    return np.stack([u, v], axis=1) + 0.5 + np.clip(np.stack(shift, axis=1), -0.5, 0.5)


def on_table(view: View, pixels: Float64) -> Float64:
    """Where the rays of pixels [N, 2] meet the table, [N, 2] metres."""
    camera = view.camera
    rays = np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1) @ np.linalg.inv(camera.K).T
    rays = rays @ camera.T_base_cam[:3, :3].T
    centre = camera.T_base_cam[:3, 3]
    reach = -(centre @ TABLE[:3] + TABLE[3]) / (rays @ TABLE[:3])
    return (centre + reach[:, None] * rays)[:, :2]


def disagreements_mm(name: str) -> list[float]:
    """Per pair of cameras: median distance on the table from a hole in one to the nearest in the other, mm."""
    rig_file = load_rig(PROJECT / "calibration" / name)
    images = {}
    for source in rig_file.videos():
        found, bgr = cv2.VideoCapture(str(source.video)).read()
        assert found
        images[source.camera] = DecodedImage(0, cv2.cvtColor(bgr, cv2.COLOR_BGR2RGB))
    views = FrameAssembler(rig_file.rig.cameras).assemble(images).views
    # Where all three cameras see the bare table well, away from arm and block.
    region = np.array([[0.3, 0.4], [0.62, 0.6]])
    spots = [on_table(view, holes(view)) for view in views]
    spots = [s[((s > region[0]) & (s < region[1])).all(axis=1)] for s in spots]
    assert min(map(len, spots)) > 40
    return [1e3 * float(np.median(KDTree(b).query(a)[0])) for a, b in combinations(spots, 2)]


@pytest.mark.skipif(not RECORDING.exists(), reason=f"{RECORDING} is absent")
def test_the_refined_cameras_agree_on_the_table_and_the_published_ones_do_not() -> None:
    refined, published = disagreements_mm("pusht_3cam_refined.yaml"), disagreements_mm("pusht_3cam.yaml")
    assert max(refined) < 2
    # Nearest holes are never further apart than half their 22 mm pitch, however wrong the poses are.
    assert max(published) > 4
