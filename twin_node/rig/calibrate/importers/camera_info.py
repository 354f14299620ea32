"""ROS camera calibration files: one camera, a folder of them, or a stereo pair whose P tells the baseline."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twin_node.geometry import pose
from twin_node.picture_files import listed
from twin_node.rig.calibrate.camera_info import CameraInfo, load_camera_info
from twin_node.rig.calibrate.importers.foreign_camera import foreign_camera, foreign_rig
from twin_node.rig.rig_file import RigFile
from twin_node.scene import Float64

NOTES = "From ROS camera_info: poses are those of the rectified pair; of single cameras unknown, all at the origin."


def import_camera_info(path: Path, unit: float = 1.0) -> RigFile:
    """Cameras of one file or of all YAML files of a folder, in the first rectified frame (REP-104)."""
    paths = [file for file in listed(path) if file.suffix in (".yaml", ".yml")] if path.is_dir() else [path]
    cameras = []
    for file in paths:
        info = load_camera_info(file)
        lens = info.lens
        cameras.append(
            foreign_camera(
                str(file),
                file.stem,
                (lens.width, lens.height),
                lens.K,
                _pose(info, unit),
                lens.distortion_model,
                lens.D,
            )
        )
    return foreign_rig(str(path), cameras, "rectified_optical_frame", NOTES)


def _pose(info: CameraInfo, unit: float) -> Float64:
    """`T_rig_cam`: a camera's points, rectified by R, are off by P's last column from the first camera's."""
    offset = np.linalg.solve(info.P[:, :3], info.P[:, 3]) * unit
    return pose(info.R, -offset)
