"""From cameras to synchronised, undistorted images."""

from twin_node.rig.errors import RigError
from twin_node.rig.evidence import CameraEvidence
from twin_node.rig.frames import DecodedImage, FrameAssembler
from twin_node.rig.rig_file import RigFile, VideoSource, load_rig, save_rig
from twin_node.rig.stamps import StampsFile, read_stamps
from twin_node.rig.synchronizer import (
    ApproximateTimeSynchronizer,
    InputCounts,
    SyncParameters,
    SyncReport,
    SyncSet,
)
from twin_node.rig.undistort import Undistorter
from twin_node.rig.workspace import workspace_of

__all__ = [
    "ApproximateTimeSynchronizer",
    "CameraEvidence",
    "DecodedImage",
    "FrameAssembler",
    "InputCounts",
    "RigError",
    "RigFile",
    "StampsFile",
    "SyncParameters",
    "SyncReport",
    "SyncSet",
    "Undistorter",
    "VideoSource",
    "load_rig",
    "read_stamps",
    "save_rig",
    "workspace_of",
]
