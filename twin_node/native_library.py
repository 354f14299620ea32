"""Compiled kernels in a running process: of the version that the callers know, and never used across a fork."""

from __future__ import annotations

import ctypes
import os
import sys
import warnings
from collections.abc import Callable
from ctypes import c_void_p
from pathlib import Path
from typing import Any, ClassVar, TypeVar

import numpy as np
from numpy.typing import NDArray

from twin_node import native_build
from twin_node.errors import TwinError


class NativeLibrary:
    """One compiled variant of a room's kernels. Safe from several threads; a forked child gets the room's error.

    A room says what it is by its class attributes, and declares and calls its own functions of `_dll`.
    """

    KERNELS: ClassVar[native_build.Kernels]
    VERSION: ClassVar[int]
    """Interface version of the structs that the room declares."""
    ERROR: ClassVar[type[TwinError]]

    def __init__(self, path: Path) -> None:
        """Loads the library file; raises `OSError` where it cannot be loaded, or is of another interface version."""
        self._dll = ctypes.CDLL(str(path))
        version = self._dll[f"{self.KERNELS.name}_interface_version"]()
        if version != self.VERSION:
            raise OSError(f"{path}: expected interface version {self.VERSION}, found {version}")
        self._forked = False
        os.register_at_fork(after_in_child=self._mark_forked)

    def _mark_forked(self) -> None:
        self._forked = True

    def _require_not_forked(self) -> None:
        """Raises the room's error in a child that was forked after the library had been loaded."""
        if self._forked:
            raise self.ERROR(
                f"{self.KERNELS.name}: called in a process forked from one that had loaded its kernels, where OpenMP "
                "would hang; start the process with the `spawn` method instead"
            )


Loaded = TypeVar("Loaded", bound=NativeLibrary)


def best_or_none(load: Callable[[str], Loaded], without: str) -> Loaded | None:
    """What `load` makes of the best variant for this processor; None, and a warning, where there is none.

    `without`: what happens then, for the warning.
    """
    try:
        return load(native_build.supported_variants()[0])
    except (native_build.CompileError, OSError) as error:
        warnings.warn(f"{without}: {error}", stacklevel=3)
        return None


def address_of(array: NDArray[Any]) -> int | None:
    """Where an array's first entry lies; good for as long as the array lives.

    What `array.ctypes.data` says, in a tenth of its time: some hundreds of addresses are asked for at every set.
    """
    return c_void_p.from_address(id(array) + _HEAD).value if _LIES_BEHIND_HEAD else array.ctypes.data


def addresses_of(*arrays: NDArray[Any] | None) -> list[int | None]:
    """Where each begins; None for None."""
    return [None if array is None else address_of(array) for array in arrays]


_HEAD = object.__basicsize__
"""Bytes of an object before its own fields, of which an array has its data first (NumPy's `PyArrayObject`)."""
_SAMPLE = np.zeros(1)
_LIES_BEHIND_HEAD = (
    sys.implementation.name == "cpython" and c_void_p.from_address(id(_SAMPLE) + _HEAD).value == _SAMPLE.ctypes.data
)
