"""Files of trajectories, read by their suffix."""

from __future__ import annotations

from pathlib import Path

from twin_node.bag.bvh import read_bvh
from twin_node.bag.csv_trajectories import read_csv
from twin_node.bag.log import BagError
from twin_node.bag.trajectories import Trajectories
from twin_node.bag.trc import read_trc


def read_trajectories(path: Path, height_m: float = 1.75) -> Trajectories:
    """Reads a `.bvh`, `.trc` or `.csv` file.

    BVH knows no unit: its person is scaled to be `height_m` tall. Raises `BagError` naming the file and the line.
    """
    kind = path.suffix.lower()
    if kind == ".bvh":
        return read_bvh(path, height_m)
    if kind == ".trc":
        return read_trc(path)
    if kind == ".csv":
        return read_csv(path)
    raise BagError(f"{path}: expected a .bvh, .trc or .csv file of trajectories, found '{path.suffix or path.name}'")
