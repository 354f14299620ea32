"""Loads the compiled kernels of the model; what is asked of them is in `kernel_requests` and `node_requests`."""

from __future__ import annotations

from functools import cache
from typing import TYPE_CHECKING

from twin_node import native_build
from twin_node.model.kernel_requests import INTERFACE_VERSION
from twin_node.model.parameters import ModelError
from twin_node.native_library import NativeLibrary

if TYPE_CHECKING:
    import torch


class Kernels(NativeLibrary):
    """One compiled variant. Safe from several threads; a forked child gets `ModelError`."""

    KERNELS, VERSION, ERROR = native_build.MODEL, INTERFACE_VERSION, ModelError
    WITHOUT = "the model finds what moves in plain NumPy, ten times slower"


@cache
def kernels() -> Kernels | None:
    """The best kernels for this processor; None, with one warning, where there are none."""
    return Kernels.best()


def kernels_for(device: torch.device) -> Kernels | None:
    """`kernels` for tensors on this device: None for those that are not on the CPU."""
    return kernels() if device.type == "cpu" else None
