"""Loads the compiled kernels of the cell; what is asked of them is in `kernel_requests`."""

from __future__ import annotations

from functools import cache

from twin_node import native_build
from twin_node.cell.errors import CellError
from twin_node.cell.kernel_requests import INTERFACE_VERSION
from twin_node.native_library import NativeLibrary


class Kernels(NativeLibrary):
    """One compiled variant. Safe from several threads; a forked child gets `CellError`."""

    KERNELS, VERSION, ERROR = native_build.CELL, INTERFACE_VERSION, CellError
    WITHOUT = "the simulated cell is drawn in plain NumPy, about four times slower"


@cache
def kernels() -> Kernels | None:
    """The best kernels for this processor; None, with one warning, where there are none."""
    return Kernels.best()
