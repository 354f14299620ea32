"""The Gaussians of a log as files of other viewers: PLY in the layout of 3DGS, and SPZ, its compressed form."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from pathlib import Path

from twin_node.model.ply import stored_from_cloud, write_ply
from twin_node.nodes.export.moments import ExportError, Moment
from twin_node.scene import GaussianCloud

WriteCloud = Callable[[GaussianCloud, Path], None]


def write_clouds(moments: Sequence[Moment], path: Path, write: WriteCloud) -> None:
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
        write(moment.cloud, path / f"{number:05d}{path.suffix}" if len(moments) > 1 else path)


def write_cloud_ply(cloud: GaussianCloud, path: Path) -> None:
    """PLY in the layout of 3DGS."""
    write_ply(stored_from_cloud(cloud), path)


def write_cloud_spz(cloud: GaussianCloud, path: Path) -> None:
    """SPZ by gsply. Raises `ExportError` where that is not installed."""
    try:
        from gsply import GSData
        from gsply.spz import write_spz
    except ImportError:
        raise ExportError("spz: expected the package gsply; install it with pip install 'twin-node[export]'") from None
    stored = stored_from_cloud(cloud)
    data = GSData.from_arrays(
        stored.means, stored.log_scales, stored.quats, stored.logits, stored.sh[:, 0], format="ply"
    )
    write_spz(str(path), data)
