"""Reads the capture times of a video's frames from JSON, CSV or plain text files."""

from __future__ import annotations

import csv
import json
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin_node.errors import kind_of, reason, repeated
from twin_node.rig.errors import RigError

UNITS_NS = {"s": 1_000_000_000, "ms": 1_000_000, "us": 1_000, "ns": 1}
"""Length of each unit in ns."""

MOST_DIGITS = 30
"""Longer numbers are not repeated to the user."""

ENCODING = "utf-8-sig"
"""Spreadsheets put a mark of their encoding before the first column's name."""

LATEST_S = 9e9
"""No stamp in seconds is later than this (year 2255; int64 ns hold no more): larger numbers are in a smaller unit."""

SHARED_CAMERA, SHARED_STAMP = "cam_id", "frame_time"
"""Columns of a file that lists the frames of all cameras."""


@dataclass(frozen=True)
class StampsFile:
    """Where the frames' capture times stand."""

    path: Path
    key: str | None = None
    """JSON: key of the list. CSV: column. Text: none."""
    unit: str = "s"
    """s, ms, us or ns."""


def read_stamps(source: StampsFile) -> NDArray[np.int64]:
    """Stamps [N] in ns as the file lists them.

    Raises `RigError` naming the file where it is missing, holds something else or is in another unit.
    """
    try:
        values = _values(source)
    except (OSError, ValueError, RecursionError, csv.Error) as error:  # ValueError: no text, no JSON
        raise RigError(f"{source.path}: expected stamps, found no readable file ({reason(error)})") from error
    return _nanoseconds(source, values)


def read_shared_stamps(path: Path, camera: str) -> NDArray[np.int64]:
    """Rising stamps [N] in ns, of seconds, of one camera in a CSV file that lists those of all.

    Raises `RigError` naming the file where it cannot be read, holds something else or nothing of the camera.
    """
    source = StampsFile(path)
    try:
        rows = list(csv.DictReader(path.read_text(encoding=ENCODING).splitlines()))
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise RigError(f"{path}: expected stamps, found no readable file ({reason(error)})") from error
    if not rows or not {SHARED_CAMERA, SHARED_STAMP} <= set(rows[0]):
        found = ", ".join(map(str, rows[0])) if rows else "none"
        raise RigError(f"{path}: expected the columns {SHARED_CAMERA} and {SHARED_STAMP}, found {found}")
    own = [row[SHARED_STAMP] for row in rows if str(row[SHARED_CAMERA]).strip() == camera]
    if not own:
        raise RigError(f"{path}: expected rows with {SHARED_CAMERA} {camera}, found none")
    return _nanoseconds(source, sorted(_number(source, value) for value in own))


def _nanoseconds(source: StampsFile, values: list[float]) -> NDArray[np.int64]:
    if not values:
        raise RigError(f"{source.path}: expected stamps, found none; check the file and its key")
    if not all(abs(value) < np.inf for value in values):  # NaN is not below anything
        raise RigError(f"{source.path}: expected finite stamps, found NaN or infinity")
    if max(map(abs, values)) * UNITS_NS[source.unit] > LATEST_S * 1e9:
        raise RigError(
            f"{source.path}: expected stamps in {source.unit}, found {_told(max(values, key=abs))}; "
            "give their unit (ms, us or ns) under `unit`"
        )
    # Python's numbers: whole nanoseconds since 1970 do not fit a float.
    return np.array([round(value * UNITS_NS[source.unit]) for value in values], dtype=np.int64)


def _told(value: float) -> str:
    digits = f"{value:.0f}" if isinstance(value, float) else str(value)
    return digits if len(digits) <= MOST_DIGITS else f"a number of {len(digits)} digits"


def _values(source: StampsFile) -> list[float]:
    text = source.path.read_text(encoding=ENCODING)
    suffix = source.path.suffix.lower()
    if suffix == ".json":
        return _json_values(source, text)
    if suffix == ".csv" and source.key is not None:
        return _column(source, source.key, text)
    return [_number(source, field) for line in text.splitlines() if (field := line.split(",")[0].strip())]


def _json_values(source: StampsFile, text: str) -> list[float]:
    data = json.loads(text)
    if isinstance(data, dict):
        if source.key not in data:
            keys = ", ".join(map(str, data))
            raise RigError(
                f"{source.path}: expected the key {source.key!r}, found {keys}; name the list of stamps under `key`"
            )
        data = data[source.key]
    if not isinstance(data, list):
        raise RigError(f"{source.path}: expected a list of stamps, found {kind_of(data)}")
    return [_number(source, value) for value in data]


def _column(source: StampsFile, key: str, text: str) -> list[float]:
    rows = csv.DictReader(text.splitlines())
    columns = rows.fieldnames or []
    if key not in columns:
        raise RigError(f"{source.path}: expected the column {key!r}, found {', '.join(columns)}")
    return [_number(source, row[key]) for row in rows]


def _number(source: StampsFile, value: object) -> float:
    if isinstance(value, int | float) and not isinstance(value, bool):
        return value
    try:
        return int(str(value)) if str(value).strip().lstrip("-").isdigit() else float(str(value))
    except ValueError as error:
        raise RigError(f"{source.path}: expected a number as a stamp, found {repeated(value)}") from error
