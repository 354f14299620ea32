"""The 4D model: Gaussians, their motion, and the window they are fitted in.

What is set is at hand at once; what follows the images loads torch when it is first asked for: the processes of a
launch that only read parameters do without its second and its 200 MB.
"""

from __future__ import annotations

import importlib
from typing import TYPE_CHECKING, Any

from twin_node.model.parameters import (
    BirthParameters,
    MapParameters,
    ModelError,
    ModelParameters,
    SeedParameters,
    TrackParameters,
)

if TYPE_CHECKING:
    from twin_node.model.moving_mask import MovingMask
    from twin_node.model.window_model import ModelImage, WindowModel

__all__ = [
    "BirthParameters",
    "MapParameters",
    "ModelError",
    "ModelImage",
    "ModelParameters",
    "MovingMask",
    "SeedParameters",
    "TrackParameters",
    "WindowModel",
]

_MODULES = {
    "ModelImage": "window_model",
    "MovingMask": "moving_mask",
    "WindowModel": "window_model",
}
"""Where the others are."""


def __getattr__(name: str) -> Any:
    if name not in _MODULES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    return getattr(importlib.import_module(f"{__name__}.{_MODULES[name]}"), name)
