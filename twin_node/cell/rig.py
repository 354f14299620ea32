"""The scenario's cameras as a calibrated rig."""

from __future__ import annotations

import numpy as np

from twin_node.cell.scenario import CameraSpec, Scenario, Sensing
from twin_node.geometry import pose
from twin_node.scene import Camera, Float64, Rig, RigCamera


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
    T_base_cam = _looking(np.array(spec.position), np.array(spec.look_at))
    return RigCamera(spec.name, sensing.width, sensing.height, K, T_base_cam)


def _looking(position: Float64, target: Float64) -> Float64:
    """Pose of an optical frame (x right, y down, z forward) at a position, looking at a point, upright."""
    forward = (target - position) / np.linalg.norm(target - position)
    up = np.array([0.0, 0.0, 1.0]) if abs(forward[2]) < 0.999 else np.array([1.0, 0.0, 0.0])
    right = np.cross(forward, up)
    right /= np.linalg.norm(right)
    return pose(np.stack([right, np.cross(forward, right), forward], axis=1), position)
