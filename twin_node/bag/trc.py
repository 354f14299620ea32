"""OpenSim's `.trc` (Track Row Column) marker files."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from twin_node.bag.log import BagError
from twin_node.bag.trajectories import Trajectories, checked, number, read_lines

_HEADER_LINES = 5
_UNITS = {"m": 1.0, "cm": 1e-2, "mm": 1e-3}


def read_trc(path: Path) -> Trajectories:
    """Marker trajectories of a `.trc` file: five header lines, then frame, time and x y z per marker.

    Times count from the first sample. Raises `BagError` naming the file and the line for anything else.
    """
    lines = read_lines(path)
    if len(lines) < _HEADER_LINES or not lines[0].startswith("PathFileType"):
        raise BagError(f"{path}: expected a .trc file (first line 'PathFileType ...'); give a file of that kind")
    header = dict(zip(lines[1].split("\t"), (cell.strip() for cell in lines[2].split("\t")), strict=False))
    scale = _UNITS.get(header.get("Units", ""))
    if scale is None:
        raise BagError(f"{path}: Units: expected m, cm or mm, found {header.get('Units')!r}; correct the header")
    names = tuple(name.strip() for name in lines[3].split("\t")[2:] if name.strip())
    if header.get("NumMarkers", "") != str(len(names)):
        raise BagError(f"{path}: line 4: expected {header.get('NumMarkers')} marker names, found {len(names)}")
    if not header.get("NumFrames", "").isdecimal():
        raise BagError(f"{path}: NumFrames: expected a number of frames, found {header.get('NumFrames')!r}; correct it")
    columns = 2 + 3 * len(names)
    rows = []
    for line, text in enumerate(lines[_HEADER_LINES:], start=_HEADER_LINES + 1):
        if not text.strip():
            continue
        cells = text.split("\t")[:columns]
        if len(cells) != columns:
            raise BagError(f"{path}: line {line}: expected {columns} columns, found {len(cells)}")
        rows.append([number(path, line, cell) for cell in cells])
    table = np.array(rows).reshape(-1, columns)
    if len(table) == 0:
        raise BagError(f"{path}: expected rows of marker positions, found none")
    if len(table) != int(header["NumFrames"]):
        raise BagError(
            f"{path}: expected {header['NumFrames']} frames, found {len(table)}; the file is cut short or was edited"
        )
    return checked(path, names, table[:, 1] - table[0, 1], table[:, 2:].reshape(len(table), len(names), 3) * scale)
