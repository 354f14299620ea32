"""Loads the compiled kernels of the forecast; what is asked of them is in `kernel_requests` and `part_requests`."""

from __future__ import annotations

from functools import cache

from twin_node import native_build
from twin_node.forecast.errors import ForecastError
from twin_node.forecast.kernel_requests import INTERFACE_VERSION
from twin_node.native_library import NativeLibrary


class Kernels(NativeLibrary):
    """One compiled variant. Safe from several threads; a forked child gets `ForecastError`."""

    KERNELS, VERSION, ERROR = native_build.FORECAST, INTERFACE_VERSION, ForecastError
    WITHOUT = "the forecast runs in plain NumPy, about ten times slower"


@cache
def kernels() -> Kernels | None:
    """The best kernels for this processor; None, with one warning, where there are none."""
    return Kernels.best()
