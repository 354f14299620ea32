"""A log's Gaussians over time as NumPy arrays."""

from __future__ import annotations

import shutil
import tempfile
import zipfile
from contextlib import ExitStack
from pathlib import Path
from typing import IO, Any

import numpy as np

from twin_node.nodes.export.moments import ExportError, Moments
from twin_node.scene import GaussianCloud

COLUMNS = ("means", "quats", "scales", "opacities", "rgb", "velocities", "tiers", "ids")
"""Fields of `scene.GaussianCloud` that are written: its nodes are not in a log."""


def write_arrays(moments: Moments, path: Path) -> None:
    """All Gaussians of all moments, one after another: moment k has rows `starts[k]` to `starts[k + 1]`.

    Arrays: `stamps` [T] ns, `starts` [T + 1], and `COLUMNS` [N, ...]. They grow on disk beside the file, not in memory.
    Raises `ExportError` where a moment has no Gaussians.
    """
    starts, first = [0], None
    with ExitStack() as files:
        grown = {name: files.enter_context(tempfile.TemporaryFile(dir=path.parent)) for name in COLUMNS}
        for moment in moments:
            if moment.cloud is None:
                raise ExportError("npz: expected Gaussians at every time, found none at some; choose a later --start")
            first = first or moment.cloud
            for name, file in grown.items():
                file.write(np.ascontiguousarray(getattr(moment.cloud, name)).data)
            starts.append(starts[-1] + len(moment.cloud.means))
        assert first is not None
        with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
            _add(archive, "stamps", np.array(moments.stamps))
            _add(archive, "starts", np.array(starts))
            for name, file in grown.items():
                _add_grown(archive, name, file, first, starts[-1])


def _add(archive: zipfile.ZipFile, name: str, array: Any) -> None:
    with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
        np.lib.format.write_array(entry, array)


def _add_grown(archive: zipfile.ZipFile, name: str, file: IO[bytes], like: GaussianCloud, rows: int) -> None:
    """An array of so many rows whose bytes are in a file, each row as those of `like`."""
    column = getattr(like, name)
    header = {"descr": np.lib.format.dtype_to_descr(column.dtype), "fortran_order": False}
    file.seek(0)
    with archive.open(f"{name}.npy", "w", force_zip64=True) as entry:
        np.lib.format.write_array_header_2_0(entry, {**header, "shape": (rows, *column.shape[1:])})
        shutil.copyfileobj(file, entry)
