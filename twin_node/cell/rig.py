"""The scenario's cameras as a calibrated rig."""

from __future__ import annotations

import numpy as np

from twin_node.cell.scenario import CameraSpec, Scenario, Sensing
from twin_node.geometry import looking_at
from twin_node.scene import Camera, Rig, RigCamera


def make_rig(scenario: Scenario) -> Rig:
    """The rig as a perfect calibration would find it."""
    cameras = tuple(_rig_camera(spec, scenario.sensing) for spec in scenario.cameras)
    return Rig(cameras, np.array(scenario.workspace))


def pinhole(camera: RigCamera) -> Camera:
    """The rig camera, which has no distortion, with the centre of the top-left pixel at (0.5, 0.5)."""
    K = camera.K.copy()
    K[:2, 2] += 0.5
    return Camera(camera.name, camera.width, camera.height, K, camera.T_base_cam, camera.sigma_m)


def _rig_camera(spec: CameraSpec, sensing: Sensing) -> RigCamera:
    focal = sensing.width / 2 / np.tan(np.radians(spec.fov_deg) / 2)
    K = np.array([[focal, 0, (sensing.width - 1) / 2], [0, focal, (sensing.height - 1) / 2], [0, 0, 1]])
    T_base_cam = looking_at(spec.position, spec.look_at)
    return RigCamera(spec.name, sensing.width, sensing.height, K, T_base_cam)
