"""What the arm carries, and what it may touch."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from twin_node.arm.errors import ArmError
from twin_node.scene import Float64

FARTHEST_REGION_M = 10.0
"""No corner of an allowed region is farther from `base_link` along an axis, m: who gives more means millimetres."""


@dataclass(frozen=True)
class Attachment:
    """A tool or a held part, as capsules in the frame of `tool0`; equal ends make a sphere."""

    name: str
    ends: Float64
    """[n, 2, 3] m."""
    radii: Float64
    """[n] m."""

    def __post_init__(self) -> None:
        """Raises `ArmError` for shapes that do not fit each other or values that make no capsule."""
        count = len(self.radii)
        if self.ends.shape != (count, 2, 3) or self.radii.shape != (count,):
            raise ArmError(
                f"attachment {self.name}: expected ends [n, 2, 3] and radii [n], found {self.ends.shape} and "
                f"{self.radii.shape}; give two ends and one radius per capsule"
            )
        if not (np.isfinite(self.ends).all() and np.isfinite(self.radii).all() and (self.radii > 0).all()):
            raise ArmError(f"attachment {self.name}: expected finite ends and positive radii in metres; correct them")


@dataclass(frozen=True)
class AllowedRegion:
    """A box in which some links may touch what stands still, as a gripper does the table it works on.

    For these links what is inside of STATIC obstacles is not looked at (all or nothing of boxes aslant and of spheres),
    nor an UNSEEN one that reaches into the box: who gives it knows that nothing stands in their way there. MOVING and
    UNKNOWN ones always are.
    """

    lower: Float64
    """[3] lower corner, m, in `base_link`."""
    upper: Float64
    """[3] upper corner, m, in `base_link`."""
    links: tuple[str, ...] = field(default=("wrist_3_link",))
    """Names of links and attachments."""

    def __post_init__(self) -> None:
        """Raises `ArmError` for corners that make no box, or one in millimetres: all that stands would lie in it."""
        corners = (self.lower, self.upper)
        is_box = all(np.shape(corner) == (3,) and (np.abs(corner) <= FARTHEST_REGION_M).all() for corner in corners)
        if not (is_box and np.less(*corners).all()):
            lower, upper = (np.asarray(corner).tolist() for corner in corners)
            raise ArmError(
                "allowed region: expected a lower corner [3] below the upper one in metres, at most "
                f"{FARTHEST_REGION_M:g} from base_link, found {lower} and {upper}; correct them"
            )
