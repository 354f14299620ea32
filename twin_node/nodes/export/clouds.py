"""The Gaussians of a log as files of other viewers: PLY in the layout of 3DGS, and SPZ, its compressed form."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np

from twin_node.model.ply import StoredGaussians, ply_bytes, stored_from_cloud
from twin_node.nodes.export.moments import ExportError, Moments

WriteCloud = Callable[[StoredGaussians, Path], None]

SPZ_BITS = 24
"""Of a coordinate in SPZ, one of them the sign."""
FINEST_BITS, COARSEST_BITS = 12, 8
"""Of those, how many tell parts of a metre: 1/4 mm as SPZ's own writers have it, 4 mm where something is far away."""


def write_clouds(moments: Moments, path: Path, write: WriteCloud) -> None:
    """One file for one moment; for more, a folder `path` with a file per moment, numbered from 0.

    Raises `ExportError` where a moment has no Gaussians.
    """
    if len(moments) > 1:
        path.mkdir()
    for number, moment in enumerate(moments):
        if moment.cloud is None:
            seconds = (moment.stamp - moments.source.start_ns) / 1e9
            raise ExportError(
                f"{path.name}: expected Gaussians at {seconds:.3f} s of the log, found none; choose a later time, or a "
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
    """SPZ by gsply, to 1/4096 m, or as finely as what lies beyond 2 km allows.

    Raises `ExportError` where gsply is not installed, and for Gaussians beyond 32 km.
    """
    try:
        import gsply
    except ImportError:
        raise ExportError("spz: expected the package gsply; install it with pip install 'twin-node[export]'") from None
    bits = _fractional_bits(stored)
    bands = stored.sh[:, 1:] if stored.degree else None
    data = gsply.GSData.from_arrays(
        stored.means, stored.log_scales, stored.quats, stored.logits, stored.sh[:, 0], bands, format="ply"
    )
    gsply.write_spz(str(path), data, fractional_bits=bits)


def _fractional_bits(stored: StoredGaussians) -> int:
    """How many bits of a coordinate tell parts of a metre, so that the farthest Gaussian still has a place."""
    farthest = float(np.abs(stored.means).max(initial=0))
    for bits in range(FINEST_BITS, COARSEST_BITS - 1, -1):
        if farthest <= _reach(bits):
            return bits
    beyond = int((np.abs(stored.means) > _reach(COARSEST_BITS)).any(axis=1).sum())
    raise ExportError(
        f"spz: expected Gaussians within {_reach(COARSEST_BITS):.0f} m of the origin, found {beyond} beyond, the "
        f"farthest {farthest:g} m away; take them away, or export to ply"
    )


def _reach(bits: int) -> float:
    """Where coordinates end, m."""
    return float((2 ** (SPZ_BITS - 1) - 1) / 2**bits)
