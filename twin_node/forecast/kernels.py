"""Loads the compiled kernels of the forecast; what is asked of them is in `kernel_requests` and `part_requests`."""

from __future__ import annotations

from functools import cache

from twin_node import native_build
from twin_node.forecast.errors import ForecastError
from twin_node.forecast.kernel_requests import INTERFACE_VERSION
from twin_node.native_library import NativeLibrary, best_or_none, load


class Kernels(NativeLibrary):
    """One compiled variant. Safe from several threads; a forked child gets `ForecastError`."""

    KERNELS, VERSION, ERROR = native_build.FORECAST, INTERFACE_VERSION, ForecastError


def load_variant(variant: str) -> Kernels:
    """The kernels of one instruction set. Raises `native_build.CompileError` or `OSError`."""
    return load(Kernels, native_build.FORECAST, variant)


@cache
def kernels() -> Kernels | None:
    """The best kernels for this processor; None, with one warning, where there are none."""
    return best_or_none(load_variant, "the forecast runs in plain NumPy, about ten times slower")
