"""Tables of trajectories, with commas between their cells."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from twin_node.bag.log import BagError
from twin_node.bag.trajectories import Trajectories, checked, number, read_lines


def read_csv(path: Path) -> Trajectories:
    """Reads a `.csv` file: a header `time,NAME_x,NAME_y,NAME_z,...`, then seconds and metres.

    Empty cells are points not seen. Raises `BagError` naming the file and the line.
    """
    try:
        rows = list(csv.reader(read_lines(path)))
    except csv.Error as error:
        raise BagError(f"{path}: expected a table of cells with commas between them, found {error}") from None
    header = [cell.strip() for cell in rows[0]] if rows else []
    names = tuple(cell[:-2] for cell in header[1::3])
    wanted = ["time"] + [f"{name}_{axis}" for name in names for axis in "xyz"]
    if not names or header != wanted:
        raise BagError(
            f"{path}: line 1: expected the header time,NAME_x,NAME_y,NAME_z,..., found {','.join(header)[:60]}"
        )
    values = []
    for line, row in enumerate(rows[1:], start=2):
        if not row:
            continue
        if len(row) != len(header):
            raise BagError(f"{path}: line {line}: expected {len(header)} cells, found {len(row)}")
        values.append([number(path, line, cell) for cell in row])
    table = np.array(values).reshape(-1, len(header))
    return checked(path, names, table[:, 0], table[:, 1:].reshape(len(table), len(names), 3))
