"""Typed access to the fields of a YAML mapping; every error says which field of which file is wrong."""

from __future__ import annotations

import datetime
import difflib

import numpy as np
from numpy.typing import NDArray

from twin_node.errors import kind_of, repeated, told
from twin_node.rig.errors import RigError

LARGEST = float(np.finfo(np.float64).max)
"""Whole numbers of YAML have no end; those beyond this are no number of ours."""


class Fields:
    """A mapping read from a file, and where it stands there."""

    def __init__(self, where: str, data: object) -> None:
        if not isinstance(data, dict):
            raise RigError(f"{where}: expected a mapping of fields, found {kind_of(data)}")
        self.where = where
        """File and path of the mapping in it, to begin error lines with."""
        self._data = data

    def named(self, where: str) -> Fields:
        """The same fields under another name in error lines."""
        return Fields(where, self._data)

    def only(self, *known: str) -> None:
        """Raises `RigError` for a key that is not among `known`, with the nearest name."""
        for key in self._data:
            if key not in known:
                near = difflib.get_close_matches(str(key), known, n=1)
                hint = f"did you mean {near[0]!r}?" if near else "remove it"
                raise RigError(f"{self.where}: expected only {', '.join(known)}, found {str(key)!r}; {hint}")

    def has(self, key: str) -> bool:
        """Whether the field is there and not null."""
        return self._data.get(key) is not None

    def is_table(self, key: str) -> bool:
        """Whether the field holds a mapping."""
        return isinstance(self._data.get(key), dict)

    def is_nested(self, key: str) -> bool:
        """Whether the field holds a list of lists."""
        value = self._data.get(key)
        return isinstance(value, list) and any(isinstance(one, list) for one in value)

    def table(self, key: str) -> Fields:
        """A field that holds a mapping."""
        return Fields(f"{self.where}.{key}", self._required(key))

    def entries(self, key: str) -> list[Fields]:
        """A field that holds a list of at least one mapping."""
        value = self._required(key)
        if not isinstance(value, list) or not value:
            raise RigError(f"{self.where}.{key}: expected a list of at least one, found {kind_of(value)}")
        return [Fields(f"{self.where}: {key}[{i}]", entry) for i, entry in enumerate(value)]

    def text(self, key: str, default: str | None = None) -> str:
        """A field that holds text; numbers and dates are taken as they are written."""
        if default is not None and not self.has(key):
            return default
        value = self._required(key)
        if isinstance(value, bool) or not isinstance(value, str | int | float | datetime.date):
            raise RigError(f"{self.where}.{key}: expected text, found {kind_of(value)}")
        return str(value)

    def number(self, key: str, default: float | None = None) -> float:
        """A field that holds a finite number."""
        if default is not None and not self.has(key):
            return default
        value = self._required(key)
        if isinstance(value, bool) or not isinstance(value, int | float) or not abs(value) <= LARGEST:
            raise RigError(f"{self.where}.{key}: expected a number, found {told(value)}{_exponent_hint(value)}")
        return float(value)

    def flag(self, key: str) -> bool:
        """A field that is true or false; false where it is missing."""
        value = self._required(key) if self.has(key) else False
        if not isinstance(value, bool):
            raise RigError(f"{self.where}.{key}: expected true or false, found {told(value)}")
        return value

    def array(self, key: str, shape: tuple[int, ...] | None) -> NDArray[np.float64]:
        """A field that holds finite numbers of the given shape; None: a list of any length."""
        value = self._required(key)
        expected = "a list of numbers" if shape is None else f"{'x'.join(map(str, shape))} numbers"
        try:
            array = np.array(value, dtype=np.float64)
        except (ValueError, TypeError, OverflowError) as error:
            raise RigError(f"{self.where}.{key}: expected {expected}, found {repeated(value)}") from error
        if any(isinstance(one, bool) for one in np.array(value, dtype=object).flat):
            raise RigError(f"{self.where}.{key}: expected {expected}, found true or false among them")
        if array.ndim != 1 if shape is None else array.shape != shape:
            found = "x".join(map(str, array.shape)) or "one number"
            raise RigError(f"{self.where}.{key}: expected {expected}, found {found}")
        if not np.isfinite(array).all():
            raise RigError(f"{self.where}.{key}: expected finite numbers, found {repeated(value)}")
        return array

    def list_of(self, key: str) -> NDArray[np.float64]:
        """A field that holds a list of finite numbers of any length, or one row or column of them."""
        value = self._required(key)
        if isinstance(value, list) and len(value) == 1 and isinstance(value[0], list):
            value = value[0]
        if isinstance(value, list) and all(isinstance(one, list) and len(one) == 1 for one in value):
            value = [one[0] for one in value]
        return Fields(self.where, {key: value}).array(key, None)

    def _required(self, key: str) -> object:
        value = self._data.get(key)
        if value is None:
            raise RigError(
                f"{self.where}: expected the field {key!r}, found {', '.join(map(str, self._data)) or 'none'}; add it"
            )
        return value


def _exponent_hint(value: object) -> str:
    """YAML 1.1 takes 1e-3 for text: the mantissa needs a point and the exponent a sign."""
    if not isinstance(value, str):
        return ""
    try:
        float(value)
    except ValueError:
        return ""
    return "; write it with a point and a signed exponent (1.0e-3) and without quotes"
