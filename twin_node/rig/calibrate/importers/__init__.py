"""Calibrations of other tools become rig files: one module per format."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Protocol

from twin_node.rig.calibrate.importers.camera_info import import_camera_info
from twin_node.rig.calibrate.importers.colmap import import_colmap
from twin_node.rig.calibrate.importers.kalibr import import_kalibr
from twin_node.rig.calibrate.importers.opencv import import_opencv
from twin_node.rig.calibrate.importers.qualisys import import_qualisys
from twin_node.rig.calibrate.importers.toml import import_toml
from twin_node.rig.rig_file import RigFile


class Importer(Protocol):
    """Reads one format."""

    def __call__(self, path: Path, unit: float = ..., /) -> RigFile:
        """`unit`: length of the file's unit, m; by default what the tool writes, mm of Qualisys, else m."""


IMPORTERS: Mapping[str, Importer] = {
    "camera_info": import_camera_info,
    "colmap": import_colmap,
    "kalibr": import_kalibr,
    "opencv": import_opencv,
    "qualisys": import_qualisys,
    "toml": import_toml,
}
"""By name of the format.

Each raises `RigError` naming the file and the field where it is not of its format or holds no usable camera.
"""

__all__ = ["IMPORTERS", "Importer"]
