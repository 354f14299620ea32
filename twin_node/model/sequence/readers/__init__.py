"""Readers of published layouts of dynamic scenes, one file each; logs are read by the room that owns them."""

from __future__ import annotations

from pathlib import Path

from twin_node.model.parameters import ModelError
from twin_node.model.sequence.readers import colmap, dnerf, neural_video
from twin_node.model.sequence.readers.options import ReadOptions
from twin_node.model.sequence.recording import Recording

LAYOUTS = {
    "poses_bounds.npy and one video per camera (Neural 3D Video)": (neural_video.recognises, neural_video.read),
    "transforms_train.json and images (D-NeRF)": (dnerf.recognises, dnerf.read),
    "sparse/ and one folder of images per camera (COLMAP)": (colmap.recognises, colmap.read),
}
"""What a layout is known by, in words; whether a folder has it; and its reader."""


def read_folder(folder: Path, options: ReadOptions) -> Recording:
    """The recording in a folder of one of `LAYOUTS`.

    Raises `ModelError` for a folder of no known layout, and whatever its reader finds wrong.
    """
    for recognises, read in LAYOUTS.values():
        if recognises(folder):
            return read(folder, options)
    expected = "; ".join(LAYOUTS)
    found = ", ".join(sorted(path.name for path in folder.iterdir())[:6]) if folder.is_dir() else "no such folder"
    raise ModelError(f"{folder}: expected {expected}; found {found or 'an empty folder'}")


__all__ = ["LAYOUTS", "ReadOptions", "read_folder"]
