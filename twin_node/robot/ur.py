"""The e-Series arms of Universal Robots: published DH parameters, limits, and capsules around their collision meshes.

DH parameters: Universal Robots, "DH Parameters for calculations of kinematics and dynamics" (support article 45194).
Joint ranges and speeds: user manuals of the e-Series, technical specifications. Accelerations: UR publishes none;
5 rad/s^2 is what its MoveIt configuration (`ur_moveit_config/config/joint_limits.yaml`) plans with.

Capsules enclose the collision meshes of UR's ROS description (`ur_description`), fitted by `capsule_fit.fit_capsules`
and rounded outwards to 1 mm. The UR16e is the UR10e with shorter tubes: its capsules are the UR10e's, moved along them.
UR7e and UR12e are a UR5e and a UR10e that carry more: the description has the same links, meshes and joint limits.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from twin_node.robot.model import ArmModel, Capsules, RobotError
from twin_node.scene import Float64

LINK_NAMES = (
    "base_link",
    "shoulder_link",
    "upper_arm_link",
    "forearm_link",
    "wrist_1_link",
    "wrist_2_link",
    "wrist_3_link",
)
JOINT_NAMES = (
    "shoulder_pan_joint",
    "shoulder_lift_joint",
    "elbow_joint",
    "wrist_1_joint",
    "wrist_2_joint",
    "wrist_3_joint",
)
_NEVER_MEET = (("base_link", "upper_arm_link"), ("wrist_1_link", "wrist_3_link"))
"""The joints' offsets keep these meshes apart, in 2000 random poses of the UR10e by 0.4 mm and 21 mm at least."""
_MAX_ACCELERATION = 5.0
"""rad/s^2, every joint."""
_UPPER_ARM, _FOREARM = 2, 3
"""Rows of `LINK_NAMES` that hold a tube."""


@dataclass(frozen=True)
class DhParameters:
    """Denavit-Hartenberg parameters of six revolute joints: link j is Rz(q) Tz(d) Tx(a) Rx(alpha) after link j - 1."""

    d: Float64
    """[6] m."""
    a: Float64
    """[6] m."""
    alpha: Float64
    """[6] rad."""


@dataclass(frozen=True)
class _Row:
    """One line of a capsule table: link, ends in the link's frame (m), radius (m)."""

    link: int
    start: tuple[float, float, float]
    end: tuple[float, float, float]
    radius: float


@dataclass(frozen=True)
class _UrArm:
    """What tells one UR arm from another."""

    shoulder_height: float
    upper_arm: float
    forearm: float
    wrist_offsets: tuple[float, float, float]
    """d4, d5, d6, m."""
    max_velocity_deg: tuple[int, int, int, int, int, int]
    """deg/s."""
    capsules: tuple[_Row, ...]
    turns_for_ever: bool = False
    """Whether the last joint has no ends."""


_UR10E_CAPSULES = (
    _Row(0, (0.0, 0.0, 0.032), (0.0, 0.0, 0.032), 0.102),
    _Row(1, (0.0, -0.013, 0.0), (0.0, -0.004, -0.004), 0.112),
    _Row(2, (-0.607, 0.0, 0.116), (-0.608, 0.0, 0.207), 0.066),
    _Row(2, (-0.012, 0.0, 0.175), (-0.547, 0.0, 0.163), 0.111),
    _Row(2, (0.0, 0.0, 0.111), (-0.007, 0.0, 0.228), 0.078),
    _Row(3, (0.001, -0.001, 0.055), (-0.273, 0.0, 0.052), 0.074),
    _Row(3, (-0.571, 0.0, 0.048), (-0.29, 0.0, 0.052), 0.074),
    _Row(4, (0.0, 0.0, -0.014), (0.0, -0.012, 0.0), 0.072),
    _Row(5, (0.0, 0.021, -0.001), (0.0, -0.002, -0.008), 0.066),
    _Row(6, (0.0, 0.001, -0.029), (0.0, -0.003, -0.03), 0.05),
)
_UR10E = _UrArm(0.1807, 0.6127, 0.57155, (0.17415, 0.11985, 0.11655), (120, 120, 180, 180, 180, 180), _UR10E_CAPSULES)
_UR5E = _UrArm(
    0.1625,
    0.425,
    0.3922,
    (0.1333, 0.0997, 0.0996),
    (180, 180, 180, 180, 180, 180),
    (
        _Row(0, (0.0, 0.0, 0.026), (0.0, 0.0, 0.044), 0.081),
        _Row(1, (0.0, -0.007, -0.011), (0.0, -0.013, -0.001), 0.086),
        _Row(2, (-0.445, -0.024, 0.1), (-0.417, 0.0, 0.2), 0.052),
        _Row(2, (-0.424, 0.0, 0.129), (-0.023, -0.001, 0.132), 0.091),
        _Row(2, (0.006, 0.001, 0.176), (0.01, 0.001, 0.089), 0.059),
        _Row(3, (0.0, 0.0, 0.029), (-0.179, -0.001, 0.016), 0.067),
        _Row(3, (-0.388, 0.0, 0.009), (-0.192, 0.003, 0.018), 0.067),
        _Row(4, (0.0, -0.01, -0.015), (0.0, 0.008, -0.019), 0.068),
        _Row(5, (0.0, -0.016, -0.007), (0.0, 0.023, -0.008), 0.055),
        _Row(6, (0.0, 0.001, -0.027), (0.001, -0.002, -0.027), 0.043),
    ),
)
_UR3E = _UrArm(
    0.15185,
    0.24355,
    0.2132,
    (0.13105, 0.08535, 0.0921),
    (180, 180, 180, 360, 360, 360),
    (
        _Row(0, (0.0, 0.0, 0.042), (0.0, 0.0, 0.027), 0.07),
        _Row(1, (0.0, -0.004, -0.008), (0.0, -0.01, 0.0), 0.07),
        _Row(2, (-0.255, 0.0, 0.073), (-0.249, 0.0, 0.161), 0.036),
        _Row(2, (-0.224, 0.001, 0.117), (-0.005, 0.0, 0.116), 0.071),
        _Row(2, (0.02, 0.0, 0.131), (0.008, 0.0, 0.07), 0.045),
        _Row(3, (-0.125, 0.0, 0.037), (-0.212, 0.0, 0.032), 0.057),
        _Row(3, (-0.008, 0.0, 0.049), (-0.099, 0.0, 0.037), 0.05),
        _Row(4, (0.0, -0.005, 0.0), (0.0, 0.0, -0.009), 0.056),
        _Row(5, (0.0, -0.01, -0.004), (0.0, 0.018, -0.001), 0.046),
        _Row(6, (0.0, 0.0, -0.021), (0.002, -0.002, -0.022), 0.039),
    ),
    turns_for_ever=True,
)


def _shortened(arm: _UrArm, upper_arm: float, forearm: float) -> _UrArm:
    """The same arm with shorter tubes: what lies in a tube's far half is moved towards its joint."""
    tubes = {_UPPER_ARM: (arm.upper_arm, upper_arm), _FOREARM: (arm.forearm, forearm)}

    def moved(link: int, point: tuple[float, float, float]) -> tuple[float, float, float]:
        if link not in tubes or point[0] > -tubes[link][0] / 2:
            return point
        return (round(point[0] + tubes[link][0] - tubes[link][1], 4), point[1], point[2])

    rows = tuple(replace(row, start=moved(row.link, row.start), end=moved(row.link, row.end)) for row in arm.capsules)
    return replace(arm, upper_arm=upper_arm, forearm=forearm, capsules=rows)


_ARMS = {
    "ur3e": _UR3E,
    "ur5e": _UR5E,
    "ur7e": _UR5E,
    "ur10e": _UR10E,
    "ur12e": _UR10E,
    "ur16e": _shortened(_UR10E, 0.4784, 0.36),
}
_OTHERS = ("ur3", "ur5", "ur10", "ur8long", "ur15", "ur18", "ur20", "ur30")
"""Arms of UR's that `ur_description` knows (its `config/`), and whose shapes are not here."""
UR_NAMES = tuple(_ARMS)
"""Names that `ur_model` knows."""


def ur_shape(name: str) -> str:
    """The first UR arm whose links are those of another ("ur5e" for "ur7e" and itself); raises as `ur_dh` does."""
    arm = _arm(name)
    return next(other for other, shape in _ARMS.items() if shape is arm)


def ur_dh(name: str) -> DhParameters:
    """Published DH parameters of a UR arm ("ur5e"); raises `RobotError` for a name that is not in `UR_NAMES`."""
    arm = _arm(name)
    d4, d5, d6 = arm.wrist_offsets
    return DhParameters(
        d=np.array([arm.shoulder_height, 0, 0, d4, d5, d6]),
        a=np.array([0, -arm.upper_arm, -arm.forearm, 0, 0, 0]),
        alpha=np.array([np.pi / 2, 0, 0, np.pi / 2, -np.pi / 2, 0]),
    )


def ur_model(name: str) -> ArmModel:
    """Model of a UR arm, by one of `UR_NAMES`; raises `RobotError` for another name."""
    arm = _arm(name)
    full_turn = np.full(6, 2 * np.pi)
    full_turn[2] = np.pi  # the elbow meets the upper arm beyond half a turn
    if arm.turns_for_ever:
        full_turn[5] = np.inf
    return ArmModel(
        name=name,
        link_names=LINK_NAMES,
        joint_names=JOINT_NAMES,
        origins=joint_origins(ur_dh(name)),
        lower=-full_turn,
        upper=full_turn,
        max_velocity=np.deg2rad(np.array(arm.max_velocity_deg, dtype=np.float64)),
        max_acceleration=np.full(6, _MAX_ACCELERATION),
        capsules=Capsules(
            links=np.array([row.link for row in arm.capsules]),
            ends=np.array([[row.start, row.end] for row in arm.capsules]),
            radii=np.array([row.radius for row in arm.capsules]),
        ),
        never_meet=_NEVER_MEET,
    )


def joint_origins(dh: DhParameters) -> Float64:
    """Poses [6, 4, 4] of the joints at angle zero, each in the link before, as `ArmModel.origins` wants them.

    A joint turns about z before its own offset d, so its frame is Tz(d) after the previous link's Tx(a) Rx(alpha). DH
    starts in `base`, which is `base_link` turned by 180 degrees about z (REP-199); the first origin holds that turn.
    """
    origins = np.tile(np.eye(4), (6, 1, 1))
    before = np.diag([-1.0, -1.0, 1.0, 1.0])
    for j in range(6):
        offset = np.eye(4)
        offset[2, 3] = dh.d[j]
        origins[j] = before @ offset
        cosine, sine = np.cos(dh.alpha[j]), np.sin(dh.alpha[j])
        before = np.array([[1, 0, 0, dh.a[j]], [0, cosine, -sine, 0], [0, sine, cosine, 0], [0, 0, 0, 1]])
    return origins


def _arm(name: str) -> _UrArm:
    if name not in _ARMS:
        known = ", ".join(UR_NAMES)
        raise RobotError(f"arm {name!r}: expected one of {known}, or an MJCF or URDF file; {_way_out(name.lower())}")
    return _ARMS[name]


def _way_out(name: str) -> str:
    """What to do with a name, in small letters, that stands for no arm here."""
    if name in _ARMS:
        return f"write it {name}"
    if name not in _OTHERS:
        return "check the name"
    return (
        f"ur_description makes one: ros2 run xacro xacro $(ros2 pkg prefix --share ur_description)/urdf/ur.urdf.xacro "
        f"name:=ur ur_type:={name} > {name}.urdf"
    )
