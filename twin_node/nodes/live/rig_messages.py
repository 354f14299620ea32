"""What a source of images says about its rig: static transforms, for viewers and recorders."""

from __future__ import annotations

from twin_node.messages import convert
from twin_node.nodes.topics import TF_STATIC
from twin_node.runtime.bus import Bus
from twin_node.scene import Rig


def publish_calibration(bus: Bus, rig: Rig, stamp: int) -> None:
    """Publish `/tf_static` and every camera's CameraInfo, which late subscribers are given too."""
    bus.publish(TF_STATIC, convert.tf_static(rig, stamp))
    for camera in rig.cameras:
        bus.publish(f"/{camera.name}/camera_info", convert.camera_info(camera, stamp))
