"""Any data that a sequence can be learnt from, as one recording: logs, and folders of published layouts."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from twin_node.model import ModelError
from twin_node.model.sequence import ReadOptions, Recording, read_folder, recording_of
from twin_node.nodes.log_source import LogSession, LogSource
from twin_node.nodes.synchronizer import SynchronizerParameters


def is_log(path: Path) -> bool:
    """Whether a path is to be read as a log: any file, and folders with rosbag2's `metadata.yaml` or its storage."""
    return (
        not path.is_dir() or (path / "metadata.yaml").is_file() or any(path.glob("*.mcap")) or any(path.glob("*.db3"))
    )


def read_recording(
    path: Path,
    options: ReadOptions,
    parameters: SynchronizerParameters,
    rig: Path | None = None,
    remaps: Mapping[str, str] | None = None,
) -> Recording:
    """All images of a log or a folder, no wider than their own; `parameters`, the rig file `rig` and `remaps` of topics
    are for logs alone.

    Raises `ModelError` for a folder of no known layout, data that is incomplete, a rig file or remaps beside a folder,
    and a log's own errors.
    """
    if not is_log(path):
        if rig is not None:
            raise ModelError(f"--rig {rig}: expected with a log; {path} is a data set, which has its own cameras")
        if remaps:
            raise ModelError(f"--remap: expected with a log; {path} is a data set, which has no topics")
        return read_folder(path, options)
    with LogSession(path, rig, remaps) as session:
        widest = max(camera.width for camera in session.rig.cameras)
        source = LogSource(session, replace(parameters, width=min(parameters.width or widest, widest)))
        return recording_of(str(path), source, options.hold_out or (), options.frames)
