"""Cameras that run, each kind in one small file behind `ImageSource`, and sets made of their images."""

from twin_node.rig.cameras.image_source import CameraHealth, CameraImage, ImageSource
from twin_node.rig.cameras.opencv import OpenCvCamera, OpenCvSource
from twin_node.rig.cameras.stamps import CaptureStamps
from twin_node.rig.cameras.synchronized import SynchronizedSource

__all__ = [
    "CameraHealth",
    "CameraImage",
    "CaptureStamps",
    "ImageSource",
    "OpenCvCamera",
    "OpenCvSource",
    "SynchronizedSource",
]
