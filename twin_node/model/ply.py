"""Gaussians as PLY files in the layout of 3DGS (Kerbl et al., TOG 2023), which viewers and simulators read."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin_node.model.parameters import ModelError
from twin_node.scene import Float32, GaussianCloud, Tier
from twin_node.unfinished import whole_file

SH_C0 = 0.28209479177387814
"""Value of the constant harmonic: the coefficient of a colour c is (c - 0.5) / this."""
FAINTEST = 1e-6
"""Opacities of 0 and 1 are stored as this far from them: the layout holds logits."""
SMALLEST_M = 1e-9
"""Scales below this are stored as it: the layout holds logarithms."""
MOST_DIGITS = 18
"""Of a count in a header: what has more is no number of bytes that a disk holds."""
MOST_SIGNS = 80
"""Of a header's line that cannot be read: what is repeated to the user."""


@dataclass(frozen=True)
class StoredGaussians:
    """Gaussians as files and optimisers hold them: log scales, logit opacities, harmonics."""

    means: Float32
    """[N, 3] m."""
    quats: Float32
    """[N, 4] w, x, y, z, not necessarily of length 1."""
    log_scales: Float32
    """[N, 3] log of metres."""
    logits: Float32
    """[N] logit of the opacity."""
    sh: Float32
    """[N, K, 3] harmonic coefficients of red, green, blue; K = (degree + 1)^2."""

    def __len__(self) -> int:
        return len(self.means)

    @property
    def degree(self) -> int:
        """Degree of the harmonics: 0 for one colour from all sides."""
        return math.isqrt(self.sh.shape[1]) - 1


def stored_from_cloud(cloud: GaussianCloud) -> StoredGaussians:
    """A published cloud in stored form, degree 0."""
    opacities = np.clip(cloud.opacities.astype(np.float64), FAINTEST, 1 - FAINTEST)
    return StoredGaussians(
        cloud.means.astype(np.float32),
        cloud.quats.astype(np.float32),
        np.log(np.maximum(cloud.scales, SMALLEST_M)).astype(np.float32),
        np.log(opacities / (1 - opacities)).astype(np.float32),
        ((cloud.rgb - np.float32(0.5)) / np.float32(SH_C0))[:, None].astype(np.float32),
    )


def cloud_from_stored(stored: StoredGaussians) -> GaussianCloud:
    """Stored Gaussians as a cloud that stands still, in the mean colour of all sides.

    Values that are not finite stay so, and scales beyond float32 become infinite; logits without end are 0 and 1.
    """
    count = len(stored)
    with np.errstate(over="ignore", invalid="ignore"):
        lengths = np.linalg.norm(stored.quats.astype(np.float64), axis=1, keepdims=True)
        quats = (stored.quats / np.where(lengths > 0, lengths, 1)).astype(np.float32)
        scales = np.exp(stored.log_scales)
        opacities = (1 / (1 + np.exp(-stored.logits.astype(np.float64)))).astype(np.float32)
        rgb = stored.sh[:, 0] * np.float32(SH_C0) + np.float32(0.5)
    return GaussianCloud(
        means=stored.means,
        quats=quats,
        scales=scales,
        opacities=opacities,
        rgb=np.where(np.isfinite(rgb), np.clip(rgb, 0, 1), rgb),
        velocities=np.zeros((count, 3), np.float32),
        tiers=np.full(count, Tier.STATIC, np.uint8),
        ids=np.arange(count, dtype=np.uint32),
        nodes=np.full(count, -1, np.int32),
    )


def ply_bytes(gaussians: StoredGaussians) -> bytes:
    """Binary PLY: x y z, normals of zero, f_dc, f_rest by channel, opacity, scale, rot; all float32."""
    names = _names(gaussians.sh.shape[1])
    table = np.zeros((len(gaussians), len(names)), "<f4")
    table[:, :3] = gaussians.means
    table[:, 6:9] = gaussians.sh[:, 0]
    rest = gaussians.sh[:, 1:].transpose(0, 2, 1).reshape(len(gaussians), 3 * (gaussians.sh.shape[1] - 1))
    table[:, 9 : 9 + rest.shape[1]] = rest
    table[:, -8] = gaussians.logits
    table[:, -7:-4] = gaussians.log_scales
    table[:, -4:] = gaussians.quats
    lines = ["ply", "format binary_little_endian 1.0", f"element vertex {len(gaussians)}"]
    header = "\n".join([*lines, *(f"property float {name}" for name in names), "end_header\n"])
    return header.encode("ascii") + table.tobytes()


def write_ply(gaussians: StoredGaussians, path: str | Path) -> None:
    """Writes binary PLY, see `ply_bytes`, whole or not at all. Raises `ModelError` where it cannot be written."""
    with whole_file(Path(path), ModelError) as partial:
        partial.write_bytes(ply_bytes(gaussians))


def read_ply(path: str | Path) -> StoredGaussians:
    """Reads Gaussians in the layout of 3DGS, properties in any order; normals and unknown properties are ignored.

    Raises `ModelError` for a file that is no binary PLY, lacks properties, or ends too early.
    """
    path = Path(path)
    try:
        data = path.read_bytes()
    except OSError as error:
        raise ModelError(f"{path}: cannot read Gaussians ({error.strerror}); expected a PLY file of 3DGS") from None
    header = _parse_header(data, path)
    body = data[header.size :]
    expected = header.count * header.dtype.itemsize
    if len(body) < expected:
        raise ModelError(
            f"{path}: expected {expected} bytes of {header.count} Gaussians, found {len(body)}; the file is cut short"
        )
    return _from_table(np.frombuffer(body[:expected], header.dtype), path)


@dataclass(frozen=True)
class _Header:
    """Where the vertices of a PLY file begin and what they are made of."""

    size: int
    count: int
    dtype: np.dtype[np.void]


_TYPES = {
    **dict.fromkeys(("char", "int8"), "i1"),
    **dict.fromkeys(("uchar", "uint8"), "u1"),
    **dict.fromkeys(("short", "int16"), "i2"),
    **dict.fromkeys(("ushort", "uint16"), "u2"),
    **dict.fromkeys(("int", "int32"), "i4"),
    **dict.fromkeys(("uint", "uint32"), "u4"),
    **dict.fromkeys(("float", "float32"), "f4"),
    **dict.fromkeys(("double", "float64"), "f8"),
}
"""PLY's names of types and numpy's."""


def _parse_header(data: bytes, path: Path) -> _Header:
    new_line = b"\r\n" if data.startswith(b"ply\r\n") else b"\n"  # as its first line ends: what follows is binary
    last = b"end_header" + new_line
    end = data.find(last)
    if not data.startswith(b"ply") or end < 0:
        raise ModelError(f"{path}: expected a PLY file with a header, found none; export it in the 3DGS layout")
    order, count, fields, in_vertex = "", -1, [], False
    for line in data[:end].decode("ascii", errors="replace").splitlines()[1:]:
        match line.split():
            case ["format", kind, _]:
                order = {"binary_little_endian": "<", "binary_big_endian": ">"}.get(kind, "")
                if not order:
                    raise ModelError(f"{path}: expected a binary PLY file, found format {kind}; export it as binary")
            case ["element", "vertex", number] if _is_count(number):
                if count >= 0:
                    raise ModelError(f"{path}: expected vertices once, found them again; export Gaussians only")
                count, in_vertex = int(number), True
            case ["element", name, number] if _is_count(number):
                if count < 0:
                    raise ModelError(f"{path}: expected vertices first, found element {name}; export Gaussians only")
                in_vertex = False
            case ["property", kind, name] if in_vertex and kind in _TYPES:
                fields.append((name, order + _TYPES[kind]))
            case ["comment" | "obj_info", *_] | []:
                continue
            case _ if in_vertex or count < 0:
                raise ModelError(
                    f"{path}: cannot read the header line '{line[:MOST_SIGNS]}'; export it in the 3DGS layout"
                )
    if not fields or not order or len({name for name, _ in fields}) != len(fields):
        raise ModelError(
            f"{path}: expected a format and an element vertex with properties, each once, in the header; "
            "the file is damaged"
        )
    return _Header(end + len(last), count, np.dtype(fields))


def _is_count(word: str) -> bool:
    return word.isdecimal() and len(word) <= MOST_DIGITS


def _from_table(table: np.ndarray, path: Path) -> StoredGaussians:
    found = set(table.dtype.names or ())
    rest = sum(name.startswith("f_rest_") for name in found)
    bases = rest // 3 + 1
    if rest % 3 or round(bases**0.5) ** 2 != bases:
        raise ModelError(f"{path}: expected 0, 9, 24 or 45 properties f_rest, found {rest}; export it from 3DGS again")
    missing = [name for name in _names(bases) if name not in found and name not in ("nx", "ny", "nz")]
    if missing:
        raise ModelError(
            f"{path}: expected the properties of 3DGS, found none called {', '.join(missing[:4])}; "
            "is it a plain point cloud?"
        )

    def columns(*names: str) -> Float32:
        with np.errstate(over="ignore"):  # doubles beyond float32 become infinite
            return np.stack([table[name] for name in names], 1).astype(np.float32)

    sh = np.zeros((len(table), bases, 3), np.float32)
    sh[:, 0] = columns("f_dc_0", "f_dc_1", "f_dc_2")
    if rest:
        sh[:, 1:] = columns(*(f"f_rest_{i}" for i in range(rest))).reshape(len(table), 3, bases - 1).transpose(0, 2, 1)
    return StoredGaussians(
        columns("x", "y", "z"),
        columns("rot_0", "rot_1", "rot_2", "rot_3"),
        columns("scale_0", "scale_1", "scale_2"),
        columns("opacity")[:, 0],
        sh,
    )


def _names(bases: int) -> list[str]:
    """Properties in the order in which 3DGS writes them."""
    rest = [f"f_rest_{i}" for i in range(3 * (bases - 1))]
    head = ["x", "y", "z", "nx", "ny", "nz", "f_dc_0", "f_dc_1", "f_dc_2"]
    return [*head, *rest, "opacity", *(f"scale_{i}" for i in range(3)), *(f"rot_{i}" for i in range(4))]
