"""Scenes of Gaussians as other programs keep them: PLY in the layout of 3DGS, and what gsply reads besides.

That is PLY as SuperSplat compresses it (`element chunk`; playcanvas/splat-transform) and SPZ up to version 4
(nianticlabs/spz: gzip up to 3, `NGSP` since).
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from twin_node.model.parameters import ModelError
from twin_node.model.ply import StoredGaussians, read_ply

PLY_HEADER_BYTES = 1 << 14
"""In which a header ends, of all programs' PLY."""
SPZ_SIGNATURES = (b"\x1f\x8b", b"NGSP")
OTHERS = {b"PK\x03\x04": "SOG, or another ZIP", b"glTF": "glTF"}
"""What else keeps Gaussians, by its first bytes."""


def read_scene(path: Path) -> StoredGaussians:
    """The Gaussians of a file, whatever its name says of its format.

    Raises `ModelError` for another format, a file that cannot be read, and where gsply is needed and not installed.
    """
    try:
        with path.open("rb") as file:
            head = file.read(PLY_HEADER_BYTES)
    except OSError as error:
        raise ModelError(f"{path}: cannot read Gaussians ({error.strerror}); expected a PLY file of 3DGS") from None
    for signature, name in OTHERS.items():
        if head.startswith(signature):
            raise ModelError(f"{path}: expected Gaussians as PLY or SPZ, found {name}; export the scene as PLY")
    if head.startswith(SPZ_SIGNATURES):
        return _by_gsply(path, "SPZ", lambda gsply: gsply.read_spz(str(path)))
    if head.startswith(b"ply") and b"\nelement chunk " in head.partition(b"end_header")[0]:
        return _by_gsply(path, "compressed PLY", lambda gsply: gsply.decompress_from_bytes(path.read_bytes()))
    return read_ply(path)


def _by_gsply(path: Path, form: str, read: Callable[[Any], Any]) -> StoredGaussians:
    try:
        import gsply

        return _stored(read(gsply))
    except ImportError:  # also of what only some forms need, from within
        raise ModelError(
            f"{path}: {form} is read by the package gsply; install it with pip install 'twin-node[export]', or export "
            "the scene as PLY without compression"
        ) from None
    except Exception as error:  # gsply's readers raise whatever they meet in a damaged file
        reason = " ".join(str(error).split()).removesuffix(f": {path}")
        raise ModelError(f"{path}: expected {form}, found a damaged file ({reason}); export it again") from None


def _stored(found: Any) -> StoredGaussians:
    """Of gsply's data; raises what NumPy does where their columns do not belong together."""
    count = len(found.means)
    sh = np.zeros((count, 1, 3)) if found.sh0 is None else np.reshape(found.sh0, (count, 1, 3))
    if found.shN is not None and np.size(found.shN):
        sh = np.concatenate([sh, np.reshape(found.shN, (count, -1, 3))], axis=1)
    columns = (found.means, found.quats, found.scales, found.opacities, sh)
    shapes = ((count, 3), (count, 4), (count, 3), (count,), sh.shape)
    return StoredGaussians(
        *(np.reshape(own, shape).astype(np.float32) for own, shape in zip(columns, shapes, strict=True))
    )
