"""RTDE protocol version 2 on the wire: packages, recipes and data, all big-endian."""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from enum import IntEnum

import numpy as np

from twin_node.cell.ur_sim.registers import Outputs, Value, output_reader
from twin_node.cell.ur_sim.rtde_types import INPUTS, NOT_FOUND, OUTPUTS, RtdeType

_HEADER = struct.Struct(">HB")
_LONGEST = 0xFFFF
"""Bytes of a package, header and all: its size has two."""


class Kind(IntEnum):
    """Package types: the ASCII codes of the letters that the guide gives them."""

    REQUEST_PROTOCOL_VERSION = ord("V")
    GET_URCONTROL_VERSION = ord("v")
    DATA_PACKAGE = ord("U")
    SETUP_OUTPUTS = ord("O")
    SETUP_INPUTS = ord("I")
    START = ord("S")
    PAUSE = ord("P")


@dataclass(frozen=True)
class Package:
    """One package as it came."""

    kind: int
    payload: bytes


def encode(kind: Kind, payload: bytes) -> bytes:
    """A package ready to send."""
    return _HEADER.pack(_HEADER.size + len(payload), kind) + payload


class PackageReader:
    """Cuts a stream of bytes into packages."""

    def __init__(self) -> None:
        self._buffer = bytearray()

    def feed(self, data: bytes) -> list[Package]:
        """Packages that are complete with these bytes.

        Raises `ValueError` for a size below that of a header: what speaks is no RTDE client.
        """
        self._buffer += data
        packages = []
        while len(self._buffer) >= _HEADER.size:
            size, kind = _HEADER.unpack_from(self._buffer)
            if size < _HEADER.size:
                raise ValueError(f"package of {size} bytes")
            if len(self._buffer) < size:
                break
            packages.append(Package(kind, bytes(self._buffer[_HEADER.size : size])))
            del self._buffer[:size]
        return packages


def names_of(payload: bytes) -> tuple[str, ...]:
    """Variable names of a recipe; clients may end it with a comma. Raises `ValueError` for bytes that are no text."""
    return tuple(name for name in payload.decode("ascii").split(",") if name)


class OutputRecipe:
    """What one client is sent, and how often."""

    def __init__(self, names: Sequence[str], rate_hz: float) -> None:
        """Raises `ValueError` for more than a package can hold."""
        self.rate_hz = rate_hz
        self.types = tuple(OUTPUTS[name].label if name in OUTPUTS else NOT_FOUND for name in names)
        self.is_complete = NOT_FOUND not in self.types
        known = [name for name in names if name in OUTPUTS]
        self._joints = [name in ("actual_q", "actual_qd") for name in known]
        self._readers: list[Callable[[Outputs], Value]] = [output_reader(name) for name in known]
        self._kinds = [OUTPUTS[name] for name in known]
        self._layout = struct.Struct(">B" + "".join(kind.code for kind in self._kinds))
        size = _HEADER.size + self._layout.size
        if size > _LONGEST:
            raise ValueError(f"recipe whose packages have {size} bytes")
        codes = "B" + "".join(kind.code[-1] * kind.count for kind in self._kinds)
        self._are_whole = [code != "d" for code in codes]

    def pack(self, outputs: Outputs) -> bytes:
        """Payload of a data package with recipe number 1, the only one of a connection."""
        values: list[float] = [1]
        for read in self._readers:
            value = read(outputs)
            if isinstance(value, np.ndarray):
                values.extend(value.tolist())
            else:
                values.append(value)
        numbers = [int(v) if is_whole else v for v, is_whole in zip(values, self._are_whole, strict=True)]
        return self._layout.pack(*numbers)

    def pack_short(self, outputs: Outputs) -> bytes:
        """The same with the last of the measured joints missing from every vector of six, as a broken sender would."""
        parts = [b"\x01"]
        for read, kind, is_joints in zip(self._readers, self._kinds, self._joints, strict=True):
            value = read(outputs)
            elements = value.tolist() if isinstance(value, np.ndarray) else [value]
            packed = struct.pack(">" + kind.code, *(v if kind.code[-1] == "d" else int(v) for v in elements))
            parts.append(packed[:-8] if is_joints else packed)
        return b"".join(parts)


@dataclass(frozen=True)
class InputRecipe:
    """What one kind of input package of a client holds."""

    names: tuple[str, ...]

    @property
    def kinds(self) -> tuple[RtdeType, ...]:
        """Types of the variables."""
        return tuple(INPUTS[name] for name in self.names)

    def unpack(self, payload: bytes) -> list[Value]:
        """Values of a data package without its recipe number; raises `ValueError` for another length."""
        layout = struct.Struct(">" + "".join(kind.code for kind in self.kinds))
        if layout.size != len(payload):
            raise ValueError(f"expected {layout.size} bytes, found {len(payload)}")
        numbers = list(layout.unpack(payload))
        values: list[Value] = []
        for kind in self.kinds:
            taken, numbers = numbers[: kind.count], numbers[kind.count :]
            values.append(taken[0] if kind.count == 1 else np.array(taken, dtype=np.float64))
        return values
