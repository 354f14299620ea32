"""Compiled kernels in a running process: of the version that the callers know, in as many threads as torch, and never
used across a fork."""

from __future__ import annotations

import contextlib
import ctypes
import os
import sys
import threading
import warnings
from collections.abc import Iterator, Sequence
from ctypes import c_void_p
from functools import cache
from pathlib import Path
from typing import Any, ClassVar, Self, TypeVar

import numpy as np
from numpy.typing import NDArray

from twin_node import native_build
from twin_node.errors import TwinError, TwinWarning


class KernelRequest(ctypes.Structure):
    """What is asked of one kernel; mirrors a struct of the room's C interface."""

    __slots__ = ()
    KERNEL: ClassVar[str]
    """The function that takes a pointer to it, without the room's name before it."""
    RETURNS: ClassVar[Any] = ctypes.c_int32
    """What that returns: a status, not 0 where there was no memory; None: nothing."""


class NativeLibrary:
    """One compiled variant of a room's kernels. Safe from several threads; a forked child gets the room's error."""

    KERNELS: ClassVar[native_build.KernelSources]
    VERSION: ClassVar[int]
    """Interface version of the structs that the room declares."""
    ERROR: ClassVar[type[TwinError]]
    WITHOUT: ClassVar[str]
    """What happens where there are none, for the warning."""

    @classmethod
    def of(cls, variant: str) -> Self:
        """The library of one instruction set, as shipped or else from the cache; compiled here where neither can be
        loaded.

        Raises `native_build.CompileError` or `OSError`.
        """
        path = cls.KERNELS.best_library(variant)
        try:
            return cls(path)
        except OSError:
            is_shipped = path == cls.KERNELS.shipped_library(variant)
            if not is_shipped and path != cls.KERNELS.cached_library(variant):
                raise
        return cls(cls.KERNELS.cached_library(variant, anew=not is_shipped))

    @classmethod
    def best(cls) -> Self | None:
        """The library for this processor; None, and a warning at the caller's caller, where there is none."""
        try:
            return cls.of(native_build.supported_variants()[0])
        except (native_build.CompileError, OSError) as error:
            warnings.warn(f"{cls.WITHOUT}: {error}", TwinWarning, stacklevel=3)
            return None

    def __init__(self, path: Path) -> None:
        """Loads the library file; raises `OSError` where it cannot be loaded, or is of another interface version."""
        self._dll = ctypes.CDLL(str(path))
        version = self._dll[f"{self.KERNELS.name}_interface_version"]()
        if version != self.VERSION:
            raise OSError(f"{path}: expected interface version {self.VERSION}, found {version}")
        self._functions: dict[type[KernelRequest], Any] = {}
        self._forked = False
        os.register_at_fork(after_in_child=self._mark_forked)

    def call(self, request: KernelRequest) -> int:
        """Calls the kernel that a request is for, and gives what it returns; 0 of one that returns nothing.

        Raises the room's error in a child that was forked after the library had been loaded.
        """
        self._require_not_forked()
        function = self._functions.get(type(request))
        if function is None:
            function = self._functions[type(request)] = self._declared(type(request))
        return function(request) or 0

    def run(self, request: KernelRequest) -> None:
        """Calls the kernel that a request is for. Raises as `call` does, and `MemoryError`."""
        if self.call(request):
            raise MemoryError(f"{self.KERNELS.name}: no memory for what its kernels work on")

    def _declared(self, kind: type[KernelRequest]) -> Any:
        function = getattr(self._dll, f"{self.KERNELS.name}_{kind.KERNEL}")
        function.argtypes, function.restype = [ctypes.POINTER(kind)], kind.RETURNS
        return function

    def _mark_forked(self) -> None:
        self._forked = True

    def _require_not_forked(self) -> None:
        """Raises the room's error in a child that was forked after the library had been loaded."""
        if self._forked:
            raise self.ERROR(
                f"{self.KERNELS.name}: called in a process forked from one that had loaded its kernels, where it would "
                "hang for want of their threads; start the process with the `spawn` method instead"
            )


_told = threading.local()


def thread_count() -> int:
    """Threads for one call of a kernel: as `kernel_threads` says, else as torch is set, where this process has it.

    Where it has not, what torch would take: the processors that the process may use, or `OMP_NUM_THREADS` if less.
    """
    if is_told():
        return int(_told.threads)
    torch = sys.modules.get("torch")
    return int(torch.get_num_threads()) if torch is not None else _openmp_threads()


def is_told() -> bool:
    """Whether this thread is within `kernel_threads`."""
    return hasattr(_told, "threads")


@contextlib.contextmanager
def kernel_threads(count: int) -> Iterator[None]:
    """Calls by this thread take `count` threads meanwhile, whatever torch is set to; then as many as before."""
    before = dict(vars(_told))
    _told.threads = count
    try:
        yield
    finally:
        del _told.threads
        vars(_told).update(before)


def keep_to_threads(count: int) -> None:
    """Calls by this thread take `count` threads from now on, whatever torch is set to."""
    _told.threads = count


def processors() -> int:
    """Those that this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


@cache
def _openmp_threads() -> int:
    asked = os.environ.get("OMP_NUM_THREADS", "").split(",")[0].strip()
    return min(int(asked), processors()) if asked.isdecimal() and int(asked) else processors()


Struct = TypeVar("Struct", bound=ctypes.Structure)


def array_of(kind: type[Struct], structs: Sequence[Struct]) -> ctypes.Array[Struct]:
    """Structs of one kind side by side, as kernels take them."""
    return (kind * len(structs))(*structs)


def address_of(array: NDArray[Any]) -> int | None:
    """Where an array's first entry lies; good for as long as the array lives.

    What `array.ctypes.data` says, in a tenth of its time: some hundreds of addresses are asked for at every set.
    """
    return c_void_p.from_address(id(array) + _HEAD).value if _LIES_BEHIND_HEAD else array.ctypes.data


def addresses_of(*arrays: NDArray[Any] | None) -> list[int | None]:
    """Where each begins; None for None."""
    if not _LIES_BEHIND_HEAD:
        return [None if array is None else array.ctypes.data for array in arrays]
    return [None if array is None else c_void_p.from_address(id(array) + _HEAD).value for array in arrays]


_HEAD = object.__basicsize__
"""Bytes of an object before its own fields, of which an array has its data first (NumPy's `PyArrayObject`)."""
_SAMPLE = np.zeros(1)
_LIES_BEHIND_HEAD = (
    sys.implementation.name == "cpython" and c_void_p.from_address(id(_SAMPLE) + _HEAD).value == _SAMPLE.ctypes.data
)
