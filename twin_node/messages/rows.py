"""Sequences of flat structs as structured arrays: a thousand obstacles are one array, not ten thousand objects.

CDR (OMG DDSI-RTPS 10.2) aligns every number to its own size, counted from the start of the body. Structs of numbers
alone that begin four bytes after a multiple of eight, and end so, lie at equal distances: their bytes are an array.
"""

from __future__ import annotations

import struct
from collections.abc import Iterator, Mapping, Sequence
from typing import Any, overload

import numpy as np
from numpy.typing import NDArray
from rosbags.interfaces import Nodetype
from rosbags.typesys.store import Typestore

HEADER = "std_msgs/msg/Header"
ENCAPSULATION = b"\x00\x01"
"""First bytes of little-endian CDR."""
BODY = 4
"""Where the body begins, bytes."""
PHASE, PERIOD = 4, 8
"""Where rows begin: `PHASE` bytes after a multiple of the largest alignment."""
CODES = {
    "bool": "?",
    "byte": "u1",
    "char": "u1",
    "int8": "i1",
    "uint8": "u1",
    "int16": "<i2",
    "uint16": "<u2",
    "int32": "<i4",
    "uint32": "<u4",
    "int64": "<i8",
    "uint64": "<u8",
    "float32": "<f4",
    "float64": "<f8",
}
"""Numbers of ROS 2 as numpy names them."""


class Rows(Sequence[Any]):
    """Messages of one flat type: `array` has a field for every number, named by its path, like `pose.position.x`."""

    def __init__(self, array: NDArray[np.void], types: Mapping[str, type[Any]], name: str, fields: Fields) -> None:
        """`types`: classes by full names, for those who ask for single messages of type `name`."""
        self.array = array
        self._types = types
        self._name = name
        self._fields = fields

    def __len__(self) -> int:
        return len(self.array)

    @overload
    def __getitem__(self, index: int) -> Any: ...
    @overload
    def __getitem__(self, index: slice) -> Rows: ...
    def __getitem__(self, index: int | slice) -> Any:
        if isinstance(index, slice):
            return Rows(self.array[index], self._types, self._name, self._fields)
        return self._message(iter(self.array[index].item()), self._name)

    def __iter__(self) -> Iterator[Any]:
        return (self._message(iter(row), self._name) for row in self.array.tolist())

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Sequence) and list(self) == list(other)

    __hash__ = None  # type: ignore[assignment]

    def _message(self, numbers: Iterator[Any], name: str) -> Any:
        values = {
            field: next(numbers) if inner is None else self._message(numbers, inner)
            for field, inner in self._fields[name].items()
        }
        return self._types[name](**values)


Fields = Mapping[str, Mapping[str, str | None]]
"""Type -> its fields, each with the type of what it holds; None: a number."""


class RowCodec:
    """Packs and unpacks messages of one type: a header and a sequence of flat structs."""

    def __init__(self, store: Typestore, name: str, field: str, element: str, dtype: np.dtype[np.void]) -> None:
        self.dtype = dtype
        """Of the rows."""
        self._store = store
        self._name = name
        self._field = field
        self._element = element
        self._fields = _fields(store, element)

    @classmethod
    def of(cls, store: Typestore, name: str) -> RowCodec | None:
        """The codec of a type; None for a type of another make."""
        fields = store.fielddefs[name][1]
        if len(fields) != 2 or fields[0] != ("header", (Nodetype.NAME, HEADER)) or fields[1][1][0] != Nodetype.SEQUENCE:
            return None
        kind, element = fields[1][1][1][0]
        if kind != Nodetype.NAME:
            return None
        dtype = _layout(store, str(element))
        return None if dtype is None else cls(store, name, fields[1][0], str(element), dtype)

    def rows(self, array: NDArray[np.void]) -> Rows:
        """An array of `dtype` as messages."""
        return Rows(array, self._store.types, self._element, self._fields)

    def unpack(self, data: memoryview) -> Any | None:
        """The message in CDR bytes, its rows a view of them; None where they are of another form."""
        if len(data) < BODY + 16 or data[:2] != ENCAPSULATION:
            return None
        frame = BODY + 8
        count_at = frame + 4 + struct.unpack_from("<I", data, frame)[0]
        count_at += -(count_at - BODY) % 4
        begin = count_at + 4
        if begin > len(data) or (begin - BODY) % PERIOD != PHASE:
            return None
        count = struct.unpack_from("<I", data, count_at)[0]
        if begin + count * self.dtype.itemsize != len(data):
            return None
        message = self._store.deserialize_cdr(bytes(data[:count_at]) + bytes(4), self._name)
        setattr(message, self._field, self.rows(np.frombuffer(data, self.dtype, count, begin)))
        return message

    def pack(self, message: Any) -> memoryview | None:
        """CDR bytes of a message; None where its structs are no rows of this layout, or do not begin where they may."""
        held = getattr(message, self._field)
        if not isinstance(held, Rows) or held.array.dtype != self.dtype:
            return None
        empty = type(message)(header=message.header, **{self._field: []})
        head = bytes(self._store.serialize_cdr(empty, self._name, little_endian=True))
        if (len(head) - BODY) % PERIOD != PHASE:
            return None
        return memoryview(head[:-4] + struct.pack("<I", len(held)) + held.array.tobytes())


def _fields(store: Typestore, name: str) -> dict[str, dict[str, str | None]]:
    """Of a type and of all that it uses."""
    found: dict[str, dict[str, str | None]] = {name: {}}
    for field, (kind, what) in store.fielddefs[name][1]:
        inner = str(what) if kind == Nodetype.NAME else None
        found[name][field] = inner
        if inner is not None:
            found |= _fields(store, inner)
    return found


def _layout(store: Typestore, name: str) -> np.dtype[np.void] | None:
    """Where the numbers of a flat struct lie; None for one that is not flat, or not of one size."""
    numbers = _numbers(store, name, "")
    if not numbers:
        return None
    offsets, at = [], PHASE
    for _, code in numbers:
        size = np.dtype(code).itemsize
        at += -at % size
        offsets.append(at - PHASE)
        at += size
    if offsets[0] or at % PERIOD != PHASE:
        return None
    names, formats = [path for path, _ in numbers], [code for _, code in numbers]
    return np.dtype({"names": names, "formats": formats, "offsets": offsets, "itemsize": at - PHASE})


def _numbers(store: Typestore, name: str, prefix: str) -> list[tuple[str, str]]:
    """Path and numpy's name of every number of a struct; none where something else is in it."""
    found: list[tuple[str, str]] = []
    for field, (kind, what) in store.fielddefs[name][1]:
        if kind == Nodetype.BASE and what[0] in CODES:
            found.append((f"{prefix}{field}", CODES[what[0]]))
        elif kind == Nodetype.NAME and (inner := _numbers(store, str(what), f"{prefix}{field}.")):
            found += inner
        else:
            return []
    return found
