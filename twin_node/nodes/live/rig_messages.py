"""What a source of images publishes: its rig's calibration, for viewers and recorders, and the images."""

from __future__ import annotations

from twin_node.messages import Message, convert
from twin_node.nodes.live.rig_source import RigParameters, topics_of
from twin_node.nodes.topics import COMPRESSED, TF_STATIC, CameraTopics
from twin_node.runtime.bus import Bus
from twin_node.scene import Float32, Rig, RigCamera, UInt8


def publish_calibration(bus: Bus, rig: Rig, parameters: RigParameters, stamp: int) -> None:
    """Publish `/tf_static` and every camera's CameraInfo beside its images, which late subscribers are given too."""
    bus.publish(TF_STATIC, convert.tf_static(rig, stamp))
    for camera in rig.cameras:
        bus.publish(topics_of(camera.name, parameters).info, convert.camera_info(camera, stamp))


def publish_image(
    bus: Bus, topics: CameraTopics, camera: RigCamera, stamp: int, rgb: UInt8, depth: Message | None
) -> None:
    """Publish an image [H, W, 3] of a stamp, ns, after its CameraInfo and, where it has a topic, its depth."""
    bus.publish(topics.info, convert.camera_info(camera, stamp))
    if topics.depth is not None and depth is not None:
        bus.publish(topics.depth, depth)
    colour = convert.compressed_image if topics.image_type == COMPRESSED else convert.raw_image
    bus.publish(topics.image, colour(camera.name, stamp, rgb))


def depth_message(topics: CameraTopics, stamp: int, depth: Float32) -> Message:
    """Depth [H, W] m as the type of its topic has it."""
    to_message = convert.compressed_depth_image if topics.depth_type == COMPRESSED else convert.depth_image
    return to_message(topics.name, stamp, depth)
