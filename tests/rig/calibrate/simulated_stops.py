"""Made-up stops of a robot that carries a camera or a target."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from twin_node.geometry import inverse_pose, pose, transform
from twin_node.rig.calibrate.hand_eye import HandEyeView, Mount
from twin_node.rig.calibrate.hand_eye_fit import HandEyeParameters
from twin_node.rig.calibrate.lenses import raw_pixels
from twin_node.scene import Float64, RigCamera

CAMERA = RigCamera(
    "wrist",
    640,
    480,
    np.array([[600.0, 0, 322], [0, 601.0, 238], [0, 0, 1]]),
    np.eye(4),
    D=np.array([0.05, -0.1, 0.001, 0, 0]),
)
SQUARE = np.stack([*np.meshgrid(np.arange(7) * 0.02, np.arange(7) * 0.02), np.zeros((7, 7))], -1).reshape(-1, 3)
OBLONG = np.stack([*np.meshgrid(np.arange(7) * 0.02, np.arange(5) * 0.02), np.zeros((5, 7))], -1).reshape(-1, 3)
FIXED = HandEyeParameters(refine_intrinsics=False, refine_scale=False)


def rigid(rng: np.random.Generator, turn: float, move: float) -> Float64:
    return pose(Rotation.from_rotvec(rng.normal(0, turn, 3)).as_matrix(), rng.normal(0, move, 3))


def session(
    rng: np.random.Generator, target: Float64, mount: Mount, noise_px: float = 0.0, stops: int = 10
) -> tuple[Float64, list[HandEyeView]]:
    """The camera's true pose in what carries it, and stops that see the target about half a metre away."""
    X, Y = rigid(rng, 0.8, 0.1), rigid(rng, 0.8, 0.3)
    views = []
    for i in range(stops):
        facing = pose(Rotation.from_euler("x", np.pi).as_matrix(), np.array([-0.06, 0.06, 0.5]))
        T_camera_target = facing @ rigid(rng, 0.25, 0.03)
        G = X @ T_camera_target @ inverse_pose(Y)
        pixels = raw_pixels(CAMERA, transform(T_camera_target, target)) + rng.normal(0, noise_px, (len(target), 2))
        views.append(HandEyeView(f"stop {i}", inverse_pose(G) if mount is Mount.CAMERA else G, pixels))
    return X, views
