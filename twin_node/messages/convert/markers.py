"""`visualization_msgs` of obstacles, cameras and decisions: what RViz and Foxglove draw without plugins."""

from __future__ import annotations

import copy
from collections.abc import Sequence

import numpy as np

from twin_node.geometry import quat_from_rotation
from twin_node.messages.convert.camera import BASE_FRAME, transform_stamped
from twin_node.messages.stamps import header, to_duration
from twin_node.messages.types import Message, message_type
from twin_node.scene import Float64, ObstacleKind, Obstacles, ObstacleShape, Rig, RigCamera, Separation

KIND_COLOURS = {
    ObstacleKind.MOVING: (0.85, 0.19, 0.15),
    ObstacleKind.STATIC: (0.60, 0.63, 0.65),
    ObstacleKind.UNKNOWN: (0.95, 0.60, 0.0),
    ObstacleKind.UNSEEN: (0.98, 0.86, 0.47),
}
"""Red, green and blue (sRGB, 0 to 1) of obstacles by kind, wherever they are shown."""
KIND_OPACITIES = {
    ObstacleKind.MOVING: 0.45,
    ObstacleKind.STATIC: 0.2,
    ObstacleKind.UNKNOWN: 0.12,
    ObstacleKind.UNSEEN: 0.12,
}
"""Opacity of obstacles by kind, live."""
FRUSTUM_COLOUR = (0.10, 0.45, 0.91, 1.0)
FRUSTUM_DEPTH_M = 0.3
"""How far a camera's frustum is drawn, m."""
LINE_WIDTH_M = 0.005
TEXT_HEIGHT_M = 0.1
LIFETIME_NS = 500_000_000
"""Obstacles and decisions vanish when none have come for so long: a viewer must not show what nobody stands for."""

_CUBE, _SPHERE, _LINE_LIST, _TEXT, _DELETE_ALL = 1, 2, 5, 9, 3
"""Constants of `visualization_msgs/Marker`."""


def obstacles_to_markers(obstacles: Obstacles) -> Message:
    """`visualization_msgs/msg/MarkerArray` of obstacles; what the last one showed is taken away first.

    Their namespaces are their kinds: who takes away all of every one names none.
    """
    wipe = _marker(obstacles.stamp, BASE_FRAME, "", 0, 0, (0.0, 0.0, 0.0, 0.0))
    wipe.action = _DELETE_ALL
    markers = [wipe]
    templates = {}
    for kind, colour in KIND_COLOURS.items():
        shown = (*colour, KIND_OPACITIES[kind])
        templates[kind] = _marker(obstacles.stamp, BASE_FRAME, kind.name.lower(), 0, _CUBE, shown)
        templates[kind].lifetime = to_duration(LIFETIME_NS)
    for row in range(len(obstacles.ids)):
        marker = copy.copy(templates[ObstacleKind(int(obstacles.kinds[row]))])  # shares what all have: time is short
        marker.id = row
        marker.type = _SPHERE if obstacles.shapes[row] == ObstacleShape.SPHERE else _CUBE
        marker.pose = pose_message(obstacles.positions[row], obstacles.quats[row])
        marker.scale = _vector(obstacles.sizes[row])
        markers.append(marker)
    return message_type("visualization_msgs/msg/MarkerArray")(markers=markers)


def frusta_to_markers(rig: Rig, stamp: int) -> Message:
    """`visualization_msgs/msg/MarkerArray` of what each camera sees, distortion left out.

    It is in `base_link`: cameras of other drivers have optical frames of other names.
    """
    markers = []
    for number, camera in enumerate(rig.cameras):
        marker = _marker(stamp, BASE_FRAME, "frusta", number, _LINE_LIST, FRUSTUM_COLOUR)
        marker.pose = pose_message(camera.T_base_cam[:3, 3], quat_from_rotation(camera.T_base_cam[:3, :3]))
        marker.scale = _vector(np.array([LINE_WIDTH_M, 0.0, 0.0]))
        point = message_type("geometry_msgs/msg/Point")
        marker.points = [point(x=float(x), y=float(y), z=float(z)) for x, y, z in _edges(camera)]
        markers.append(marker)
    return message_type("visualization_msgs/msg/MarkerArray")(markers=markers)


def separation_to_marker(separation: Separation) -> Message:
    """`visualization_msgs/msg/Marker`: the speed that the arm is left, and why, above its base."""
    share = min(max(separation.speed_fraction, 0.0), 1.0)
    marker = _marker(separation.stamp, BASE_FRAME, "separation", 0, _TEXT, (1.0 - share, share, 0.1, 1.0))
    marker.pose = pose_message(np.array([0.0, 0.0, 1.2]), np.array([1.0, 0.0, 0.0, 0.0]))
    marker.scale = _vector(np.array([0.0, 0.0, TEXT_HEIGHT_M]))
    marker.lifetime = to_duration(LIFETIME_NS)
    marker.text = f"{100 * share:.0f} %: {separation.reason}"
    return marker


def links_to_tf(names: Sequence[str], poses: Float64, stamp: int) -> Message:
    """`tf2_msgs/msg/TFMessage` with `base_link` -> every link, of poses [n, 4, 4] in `base_link`."""
    return message_type("tf2_msgs/msg/TFMessage")(
        transforms=[
            transform_stamped(BASE_FRAME, name, pose, stamp)
            for name, pose in zip(names, poses, strict=True)
            if name != BASE_FRAME
        ]
    )


def _edges(camera: RigCamera) -> Float64:
    """[16, 3] ends of the eight edges of a frustum, m, in the optical frame."""
    u = np.array([-0.5, camera.width - 0.5, camera.width - 0.5, -0.5])
    v = np.array([-0.5, -0.5, camera.height - 0.5, camera.height - 0.5])
    rays = np.stack([(u - camera.K[0, 2]) / camera.K[0, 0], (v - camera.K[1, 2]) / camera.K[1, 1], np.ones(4)], axis=1)
    corners = FRUSTUM_DEPTH_M * rays
    spokes = np.stack([np.zeros((4, 3)), corners], axis=1)
    rim = np.stack([corners, np.roll(corners, -1, axis=0)], axis=1)
    return np.concatenate([spokes, rim]).reshape(-1, 3)


def _marker(
    stamp: int, frame: str, namespace: str, number: int, shape: int, colour: tuple[float, float, float, float]
) -> Message:
    return message_type("visualization_msgs/msg/Marker")(
        header=header(stamp, frame),
        ns=namespace,
        id=number,
        type=shape,
        action=0,
        pose=pose_message(np.zeros(3), np.array([1.0, 0.0, 0.0, 0.0])),
        scale=_vector(np.zeros(3)),
        color=_rgba(colour),
        lifetime=to_duration(0),
        frame_locked=False,
        points=[],
        colors=[],
        texture_resource="",
        texture=message_type("sensor_msgs/msg/CompressedImage")(
            header=header(0, ""), format="", data=np.zeros(0, dtype=np.uint8)
        ),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=message_type("visualization_msgs/msg/MeshFile")(filename="", data=np.zeros(0, dtype=np.uint8)),
        mesh_use_embedded_materials=False,
    )


def _rgba(colour: tuple[float, float, float, float]) -> Message:
    red, green, blue, opacity = colour
    return message_type("std_msgs/msg/ColorRGBA")(r=red, g=green, b=blue, a=opacity)


def pose_message(position: Float64, quat: Float64) -> Message:
    """A `geometry_msgs/msg/Pose`; `quat` is w, x, y, z."""
    x, y, z = (float(value) for value in position)
    qw, qx, qy, qz = (float(value) for value in quat)
    return message_type("geometry_msgs/msg/Pose")(
        position=message_type("geometry_msgs/msg/Point")(x=x, y=y, z=z),
        orientation=message_type("geometry_msgs/msg/Quaternion")(x=qx, y=qy, z=qz, w=qw),
    )


def _vector(values: Float64) -> Message:
    x, y, z = (float(value) for value in values)
    return message_type("geometry_msgs/msg/Vector3")(x=x, y=y, z=z)
