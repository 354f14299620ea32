"""The 4D model: Gaussians, their motion, and the window they are fitted in."""

from twin_node.model.camera_mask import MovingMaskParameters
from twin_node.model.moving_mask import MovingMask
from twin_node.model.parameters import (
    BirthParameters,
    MapParameters,
    ModelError,
    ModelParameters,
    SeedParameters,
    TrackParameters,
)
from twin_node.model.window_model import ModelImage, WindowModel

__all__ = [
    "BirthParameters",
    "MapParameters",
    "ModelError",
    "ModelImage",
    "ModelParameters",
    "MovingMask",
    "MovingMaskParameters",
    "SeedParameters",
    "TrackParameters",
    "WindowModel",
]
