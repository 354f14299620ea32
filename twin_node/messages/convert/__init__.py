"""The records of `twin_node.scene` as messages, and back."""

from twin_node.messages.convert.arm import (
    has_velocities,
    joint_path_from_message,
    joint_path_to_message,
    joint_sample_from_message,
    joint_sample_to_message,
    separation_from_message,
    separation_to_message,
)
from twin_node.messages.convert.camera import (
    BASE_FRAME,
    TransformTree,
    camera_info,
    of_pair,
    optical_frame,
    rig_camera,
    tf_static,
    transform_stamped,
)
from twin_node.messages.convert.collision_objects import obstacles_to_collision_object
from twin_node.messages.convert.diagnostics import (
    Diagnosis,
    Level,
    Reading,
    diagnostics_from_message,
    diagnostics_to_message,
)
from twin_node.messages.convert.forecast import (
    obstacles_from_message,
    obstacles_to_message,
    occupancy_from_message,
    occupancy_to_message,
)
from twin_node.messages.convert.gaussians import gaussians_from_pointcloud2, gaussians_to_pointcloud2
from twin_node.messages.convert.image import (
    JPEG_QUALITY,
    compressed_depth_image,
    compressed_image,
    depth_from_message,
    depth_image,
    is_jpeg,
    raw_image,
    rgb_from_message,
    source_encoding,
)
from twin_node.messages.convert.markers import (
    frusta_to_markers,
    links_to_tf,
    obstacles_to_markers,
    separation_to_marker,
)
from twin_node.messages.convert.pointcloud2 import occupancy_to_pointcloud2
from twin_node.messages.convert.status import (
    Status,
    clock_from_message,
    clock_to_message,
    line_to_log,
    status_from_message,
    status_to_message,
)

__all__ = [
    "BASE_FRAME",
    "JPEG_QUALITY",
    "Diagnosis",
    "Level",
    "Reading",
    "Status",
    "TransformTree",
    "camera_info",
    "clock_from_message",
    "clock_to_message",
    "compressed_depth_image",
    "compressed_image",
    "depth_from_message",
    "depth_image",
    "diagnostics_from_message",
    "diagnostics_to_message",
    "frusta_to_markers",
    "gaussians_from_pointcloud2",
    "gaussians_to_pointcloud2",
    "has_velocities",
    "is_jpeg",
    "joint_path_from_message",
    "joint_path_to_message",
    "joint_sample_from_message",
    "joint_sample_to_message",
    "line_to_log",
    "links_to_tf",
    "obstacles_from_message",
    "obstacles_to_collision_object",
    "obstacles_to_markers",
    "obstacles_to_message",
    "occupancy_from_message",
    "occupancy_to_message",
    "occupancy_to_pointcloud2",
    "of_pair",
    "optical_frame",
    "raw_image",
    "rgb_from_message",
    "rig_camera",
    "separation_from_message",
    "separation_to_marker",
    "separation_to_message",
    "source_encoding",
    "status_from_message",
    "status_to_message",
    "tf_static",
    "transform_stamped",
]
