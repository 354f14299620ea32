"""The Gaussians of a log as files of other viewers: PLY in the layout of 3DGS, and SPZ, its compressed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

from twin_node.model.ply import StoredGaussians, ply_bytes, stored_from_cloud
from twin_node.nodes.export.moments import ExportError, Moments

WriteCloud = Callable[[StoredGaussians, Path], None]


def write_clouds(moments: Moments, path: Path, write: WriteCloud) -> None:
    """One file for one moment; for more, a folder `path` with a file per moment, numbered from 0.

    Raises `ExportError` where a moment has no Gaussians.
    """
    if len(moments) > 1:
        path.mkdir()
    for number, moment in enumerate(moments):
        if moment.cloud is None:
            raise ExportError(
                f"{path.name}: expected Gaussians at {moment.seconds:.3f} s, found none; choose a later --start, or a "
                "log that 'twin_node replay LOG -o FILE' has written"
            )
        stored = stored_from_cloud(moment.cloud)
        if moment.harmonics is not None:
            stored = replace(stored, sh=moment.harmonics)
        write(stored, path / f"{number:05d}{path.suffix}" if len(moments) > 1 else path)


def write_ply(stored: StoredGaussians, path: Path) -> None:
    """PLY in the layout of 3DGS. Raises `OSError` where it cannot be written."""
    path.write_bytes(ply_bytes(stored))


def write_spz(stored: StoredGaussians, path: Path) -> None:
    """SPZ by gsply. Raises `ExportError` where that is not installed."""
    try:
        import gsply
    except ImportError:
        raise ExportError("spz: expected the package gsply; install it with pip install 'twin-node[export]'") from None
    bands = stored.sh[:, 1:] if stored.degree else None
    data = gsply.GSData.from_arrays(
        stored.means, stored.log_scales, stored.quats, stored.logits, stored.sh[:, 0], bands, format="ply"
    )
    gsply.write_spz(str(path), data)
