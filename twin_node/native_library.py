"""Compiled kernels in a running process: of the version that the callers know, and never used across a fork."""

from __future__ import annotations

import ctypes
import os
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import ClassVar, TypeVar

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
