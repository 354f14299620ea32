"""Makes a calibration fit frames of another size than it was made for."""

from __future__ import annotations

from dataclasses import dataclass, replace

from twin_node.bag.log import BagError
from twin_node.scene import RigCamera

MAX_BAND = 0.05
"""Share of a side that bands may fill; wider ones are not a converter's rounding but another camera mode."""


@dataclass(frozen=True)
class FittedCamera:
    """A camera whose calibration fits its frames."""

    camera: RigCamera
    warning: str | None = None
    """What was assumed, in one line; None where nothing was."""


def fit_to_frames(camera: RigCamera, width: int, height: int) -> FittedCamera:
    """The camera for frames of `width` x `height` pixels.

    Frames of another size are taken as video converters make them: the whole image scaled to fit and centred between
    bands. Raises `BagError` where the bands would fill more than 5 % of a side.
    """
    if (width, height) == (camera.width, camera.height):
        return FittedCamera(camera)
    sizes = f"camera {camera.name}: video is {width}x{height}, calibration is for {camera.width}x{camera.height}"
    scale = min(width / camera.width, height / camera.height)
    band_x, band_y = (width - scale * camera.width) / 2, (height - scale * camera.height) / 2
    if band_x > MAX_BAND * width or band_y > MAX_BAND * height:
        raise BagError(
            f"{sizes}; expected the same size or shape; calibrate the camera in the mode that it recorded in"
        )
    K = camera.K * scale
    K[0, 2] = (camera.K[0, 2] + 0.5) * scale - 0.5 + band_x
    K[1, 2] = (camera.K[1, 2] + 0.5) * scale - 0.5 + band_y
    K[2, 2] = 1.0
    bands = f"bands of {band_x:.1f} px left and right, {band_y:.1f} px above and below"
    warning = f"{sizes}: taken as scaled by {scale:.4f} between {bands}; give K for the video's size to be sure"
    return FittedCamera(replace(camera, width=width, height=height, K=K), warning)
