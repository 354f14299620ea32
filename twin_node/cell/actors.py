"""What acts in a simulated cell, and what stands in it: bodies, people and the arm, as data."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property

import numpy as np

from twin_node.arm.cycle import CycleParameters
from twin_node.arm.tool import FARTHEST_TOOL_M, ToolCapsule
from twin_node.cell.errors import CellError
from twin_node.cell.motion import FARTHEST_M, Path
from twin_node.cell.shapes import Form, Shape
from twin_node.cell.textures import Texture
from twin_node.geometry import pose
from twin_node.ranges import Range, check_ranges
from twin_node.robot import UR_NAMES
from twin_node.scene import Float64

Triple = tuple[float, float, float]

SIZES = {Form.SPHERE: 1, Form.CAPSULE: 2, Form.BOX: 3}
"""Numbers that give a form its size."""

SHIRT = Texture(pattern="checker", color=(60, 80, 160), color2=(220, 220, 230), scale_m=0.06)
SKIN = Texture(pattern="speckle", color=(205, 150, 120), color2=(165, 105, 80), scale_m=0.04)
TROUSERS = Texture(pattern="stripes", color=(50, 50, 60), color2=(80, 80, 95), scale_m=0.08)
ARM_PAINT = Texture(pattern="stripes", color=(200, 205, 210), color2=(95, 130, 170), scale_m=0.12)


@dataclass(frozen=True)
class Part:
    """One primitive of a body, in the body's frame."""

    form: str = "box"
    """sphere, capsule or box."""
    size: tuple[float, ...] = (0.1, 0.1, 0.1)
    """m; sphere: radius; capsule: radius, distance of the end centres (along z); box: extents in x, y, z."""
    position: Triple = (0.0, 0.0, 0.0)
    """Centre, m."""
    rpy_deg: Triple = (0.0, 0.0, 0.0)
    texture: Texture = field(default_factory=Texture)

    def __post_init__(self) -> None:
        forms = {form.value: count for form, count in SIZES.items()}
        if self.form not in forms:
            raise CellError(f"part: form must be one of {', '.join(forms)}, found '{self.form}'")
        if len(self.size) != forms[self.form] or min(self.size) <= 0:
            raise CellError(
                f"part: a {self.form} takes {forms[self.form]} positive sizes in metres, found {list(self.size)}"
            )
        if not (np.abs([*self.size, *self.position]) <= FARTHEST_M).all():
            raise CellError(
                f"part: expected size and position in metres, at most {FARTHEST_M:g}, found {list(self.size)} and "
                f"{list(self.position)}"
            )

    @property
    def shape(self) -> Shape:
        """The primitive in its own frame."""
        return Shape(Form(self.form), self.size)

    @property
    def about(self) -> ToolCapsule:
        """A capsule that holds it, in the body's frame."""
        half = self.shape.half_extents
        axis = int(np.argmax(half))
        radius = float(np.linalg.norm(np.delete(half, axis))) if self.form == "box" else self.size[0]
        along = self.T_body_part[:3, axis] * (half[axis] - (0 if self.form == "box" else radius))
        center = self.T_body_part[:3, 3]
        return ToolCapsule(_triple(center - along), _triple(center + along), radius)

    @cached_property
    def T_body_part(self) -> Float64:
        """[4, 4] maps the primitive's coordinates to the body's."""
        from scipy.spatial.transform import Rotation  # loads slowly, and who only reads a scenario never asks

        return pose(Rotation.from_euler("xyz", self.rpy_deg, degrees=True).as_matrix(), np.array(self.position))


@dataclass(frozen=True)
class Body:
    """A rigid body: one or more parts on a path."""

    name: str = ""
    parts: tuple[Part, ...] = ()
    path: Path = field(default_factory=Path)

    def __post_init__(self) -> None:
        if not self.parts:
            raise CellError(f"body '{self.name}': expected at least one part under 'parts', found none")


@dataclass(frozen=True)
class BvhMotion:
    """A motion capture file (BVH, y up) that a whole body follows; before and after it the body stands still."""

    file: str = ""
    """Beside the scenario file that names it, or a path."""
    position: Triple = (1.3, 0.0, -0.81)
    """Where the hips are at `from_s` (x, y), and the height of the ground (z), m."""
    yaw_deg: float = 0.0
    """Turn about z; at 0 the file's z axis, to which most recordings face, is x."""
    start_s: float = 0.0
    """When the recording begins, s after the scenario's start."""
    from_s: float = 0.0
    """Where in the recording to begin, s."""
    to_s: float = 1e9
    """Where in the recording to end, s."""
    pace: float = 1.0
    """How many seconds of the recording go by in one."""

    def __post_init__(self) -> None:
        if not self.file:
            raise CellError("motion: expected a BVH file under 'file', found none")
        if not 0.05 <= self.pace <= 20 or not 0 <= self.from_s < self.to_s:
            raise CellError(
                f"motion '{self.file}': expected pace from 0.05 to 20 and 0 <= from_s < to_s, "
                f"found {self.pace}, {self.from_s} and {self.to_s}"
            )
        if not (np.abs(self.position) <= FARTHEST_M).all():
            raise CellError(
                f"motion '{self.file}': expected position in metres, at most {FARTHEST_M:g} from base_link, found "
                f"{list(self.position)}"
            )


@dataclass(frozen=True)
class Person:
    """A person of capsules: standing, the right hand on a path, or the whole body on a recorded motion.

    Limb lengths are fractions of the height; those of a recorded motion are its own, scaled to the height.
    """

    name: str = "person"
    motion: BvhMotion | None = None
    """Takes the place of `shoulder` and `hand`."""
    shoulder: Path = field(default_factory=Path)
    """The right shoulder; yaw is the way the person faces (0: along +x)."""
    hand: Path = field(default_factory=Path)
    """The middle of the right hand; held at the arm's length where it is out of reach."""
    height_m: float = 1.75
    shirt: Texture = SHIRT
    skin: Texture = SKIN
    trousers: Texture = TROUSERS

    def __post_init__(self) -> None:
        check_ranges(self, CellError, f"person '{self.name}': ", height_m=Range(0.3, 3))


@dataclass(frozen=True)
class ArmSpec:
    """The UR arm of the cell, which follows its default pick-and-place path."""

    model: str = "ur5e"
    workspace: tuple[Triple, Triple] | None = None
    """Lower and upper corner of where it picks and places, m; None: the scenario's."""
    cycle: CycleParameters = field(default_factory=CycleParameters)
    """How fast its program runs, and how far beyond `tool0` its tool picks and places."""
    tool: tuple[ToolCapsule, ...] = ()
    """What it carries for good, a gripper for example, in the frame of `tool0`."""
    handled: tuple[Part, ...] = ()
    """What it picks and places, in the frame of `tool0` while that holds it. It stands at the pick point at first; the
    arm places it, comes once with nothing and takes it back, and so on."""
    joint_rate_hz: float = 125.0
    """Rate of the joint states (a UR e-series controller allows up to 500 Hz)."""
    texture: Texture = ARM_PAINT

    @property
    def carried(self) -> tuple[ToolCapsule, ...]:
        """Its tool and capsules about what it holds at times: what a twin is told that it carries."""
        return (*self.tool, *(part.about for part in self.handled))

    def __post_init__(self) -> None:
        if self.model not in UR_NAMES:
            raise CellError(
                f"arm: model: expected one of {', '.join(UR_NAMES)}, found '{self.model}'; other arms, and those of "
                "files, are not simulated"
            )
        if self.workspace is not None:
            require_corners("arm", self.workspace)
        check_ranges(self, CellError, "arm: ", joint_rate_hz=Range(0, 1000, above=True))
        speeds = {"speed": Range(0.01, 100), "acceleration": Range(0.01, 1000)}
        lengths = {"lift_m": Range(0, 10), "tool_length_m": Range(0, FARTHEST_TOOL_M)}
        check_ranges(self.cycle, CellError, "arm: cycle.", **speeds, dwell_s=Range(0, 3600), **lengths)


def require_corners(where: str, workspace: tuple[Triple, Triple]) -> None:
    """Raises `CellError`, naming `where`, for what is no lower and upper corner of a box (m)."""
    if np.any(np.array(workspace[0]) >= np.array(workspace[1])):
        raise CellError(f"{where}: workspace must be a lower and an upper corner, found {workspace}")


def _triple(values: Float64) -> Triple:
    x, y, z = values.tolist()
    return x, y, z
