"""What flows between the rooms: frozen records over numpy arrays, in `base_link`, SI units, stamps in int ns."""

from twin_node.scene.arrays import Bool, Float32, Float64, UInt8, UInt32, read_only
from twin_node.scene.camera_names import NAME_WANTED, as_camera_name, is_camera_name
from twin_node.scene.future import (
    HORIZONS_NS,
    NO_EVIDENCE,
    Grid,
    MotionExpert,
    ObstacleKind,
    Obstacles,
    ObstacleShape,
    Occupancy,
    OccupancyLayer,
    Separation,
)
from twin_node.scene.images import Camera, FrameSet, FrameSource, JointPath, JointSample, Rig, RigCamera, View
from twin_node.scene.stamps import count_as_python
from twin_node.scene.twin import PLAIN, Exposure, GaussianCloud, NodeStates, Tier, TwinState

__all__ = [
    "HORIZONS_NS",
    "NAME_WANTED",
    "NO_EVIDENCE",
    "PLAIN",
    "Bool",
    "Camera",
    "Exposure",
    "Float32",
    "Float64",
    "FrameSet",
    "FrameSource",
    "GaussianCloud",
    "Grid",
    "JointPath",
    "JointSample",
    "MotionExpert",
    "NodeStates",
    "ObstacleKind",
    "ObstacleShape",
    "Obstacles",
    "Occupancy",
    "OccupancyLayer",
    "Rig",
    "RigCamera",
    "Separation",
    "Tier",
    "TwinState",
    "UInt8",
    "UInt32",
    "View",
    "as_camera_name",
    "count_as_python",
    "is_camera_name",
    "read_only",
]
