"""A person whose body follows a motion capture file: every bone a capsule."""

from __future__ import annotations

from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from twin_node.bag.bvh import BvhClip, read_clip
from twin_node.cell import people
from twin_node.cell.actors import BvhMotion, Person
from twin_node.cell.errors import CellError
from twin_node.cell.solids import Solid, capsule_between
from twin_node.cell.textures import Texture
from twin_node.scene import Float64

_RADII = (
    (("thumb", "finger", "hand", "wrist"), people.HAND_RADIUS),
    (("forearm", "elbow"), people.FOREARM_RADIUS),
    (("shoulder", "collar", "clavicle"), people.SHOULDER_RADIUS),
    (("arm",), people.UPPER_ARM_RADIUS),
    (("head",), people.HEAD_RADIUS),
    (("neck",), 0.06),
    (("toe", "foot", "ankle"), 0.05),
    (("leg", "thigh", "knee", "shin", "femur", "tibia"), people.LEG_RADIUS),
    (("hip", "pelvis", "spine", "back", "chest", "abdomen", "root"), people.TORSO_RADIUS),
)
"""Parts of the name of the joint that a bone begins at, the first that fits, and the bone's radius, m."""
_OTHER_RADIUS = 0.06
"""m, for joints of other names."""
_SHORTEST_BONE_M = 0.03
"""Shorter bones lie inside their neighbours."""
_UPRIGHT_PERCENTILE = 90.0
"""The height that the head's end reaches above the lowest joint: more would take the noise, less a bent back."""
_FILE_TO_BASE = np.array([[0.0, 0.0, 1.0], [1.0, 0.0, 0.0], [0.0, 1.0, 0.0]])
"""The file's z is forward, its x left, its y up."""
_ASIDE = 0.01
"""How far to the side of the root, as a share of the skeleton's height, a hip or shoulder is."""


class RecordedBody:
    """A person's bones in `base_link` at any time."""

    def __init__(self, person: Person, motion: BvhMotion) -> None:
        """Raises `BagError` for a file that is no BVH, `CellError` for a skeleton without bones and for a motion that
        begins after its recording."""
        clip = _clip(motion.file)
        lasts_s = (len(clip.positions) - 1) * clip.frame_s
        if motion.from_s > lasts_s:
            raise CellError(
                f"{motion.file}: from_s must lie within the recording, found {motion.from_s:g}; the recording lasts "
                f"{lasts_s:g} s"
            )
        newest = len(clip.positions) - 1
        begin, end = (min(t / clip.frame_s, newest) for t in (motion.from_s, motion.to_s))
        first = int(begin)
        points = _in_base(clip, person.height_m, motion)[first : int(np.ceil(end)) + 1]
        bones = _bones(clip, points[0])
        if not len(bones):
            raise CellError(f"{motion.file}: expected a body's skeleton, found no bone of {_SHORTEST_BONE_M} m")
        self._begin, self._end = begin - first, end - first
        """The part that is taken, between the frames that hold it."""
        points[..., :2] += np.array(motion.position[:2]) - _between(points, self._begin)[0, :2]
        self._ends = points[:, bones]
        self._left, self._right = (points[:, row] for row in _hips(clip))
        self._frame_s = clip.frame_s
        self._motion = motion
        self._radii = np.array([_radius(clip.joints[start].name) for start, _ in bones])
        self._textures = tuple(_texture(person, radius) for radius in self._radii)

    def ends(self, t: float) -> Float64:
        """Ends [B, 2, 3] of the bones at `t` seconds after the scenario's start, m."""
        return self._at(t, self._ends)

    def solids(self, t: float, shift: Float64, owner: int) -> list[Solid]:
        """The bones' capsules at a time, moved by a shift [3] (m)."""
        side = self._at(t, self._left - self._right)
        placed = zip(self.ends(t) + shift, self._radii, self._textures, strict=True)
        return [
            Solid(capsule_between(ends[0], ends[1], float(radius), side), texture, owner)
            for ends, radius, texture in placed
        ]

    def _at(self, t: float, values: Float64) -> Float64:
        """Values [T, ...] given per frame, at a time."""
        frame = self._begin + (t - self._motion.start_s) * self._motion.pace / self._frame_s
        return _between(values, float(np.clip(frame, self._begin, self._end)))


def _between(values: Float64, frame: float) -> Float64:
    """Values [T, ...] given per frame, between the two frames next to one."""
    before = int(frame)
    share = frame - before
    between: Float64 = (1 - share) * values[before] + share * values[min(before + 1, len(values) - 1)]
    return between


@lru_cache(maxsize=16)
def _clip(file: str) -> BvhClip:
    return read_clip(Path(file))


def _in_base(clip: BvhClip, height_m: float, motion: BvhMotion) -> Float64:
    """Joints [T, J, 3] in metres, turned into `base_link`'s axes, the lowest one of all frames on the ground."""
    top = int(_at_rest(clip)[:, 1].argmax())
    heights = clip.positions[:, top, 1] - clip.positions[..., 1].min(axis=1)
    upright = float(np.percentile(heights, _UPRIGHT_PERCENTILE))
    if not upright > 0:
        raise CellError(
            f"{motion.file}: expected a person who stands with y up, found one {upright} high; turn the file"
        )
    yaw = np.radians(motion.yaw_deg)
    turn = np.array([[np.cos(yaw), -np.sin(yaw), 0.0], [np.sin(yaw), np.cos(yaw), 0.0], [0.0, 0.0, 1.0]])
    points: Float64 = clip.positions @ (turn @ _FILE_TO_BASE).T * (height_m / upright)
    points[..., 2] += motion.position[2] - points[..., 2].min()
    return points


def _at_rest(clip: BvhClip) -> Float64:
    """Joints [J, 3] with every angle at zero, in the file's frame."""
    rest = np.zeros((len(clip.joints), 3))
    for row, joint in enumerate(clip.joints):
        rest[row] = np.array(joint.offset) + (rest[joint.parent] if joint.parent >= 0 else 0.0)
    return rest


def _hips(clip: BvhClip) -> NDArray[np.int64]:
    """Rows [2] of the first joint to the left and to the right of the root: the hips, or else the shoulders."""
    rest = _at_rest(clip)
    aside = (rest[:, 0] - rest[0, 0]) / max(float(np.ptp(rest[:, 1])), 1e-9)
    return np.array([int((aside > _ASIDE).argmax()), int((aside < -_ASIDE).argmax())])


def _bones(clip: BvhClip, points: Float64) -> NDArray[np.int64]:
    """Rows [B, 2] of the joints at both ends of every bone that is long enough in a frame [J, 3]."""
    pairs = np.array(
        [[joint.parent, row] for row, joint in enumerate(clip.joints) if joint.parent >= 0], dtype=np.int64
    )
    pairs = pairs.reshape(-1, 2)
    long: NDArray[np.bool_] = np.linalg.norm(points[pairs[:, 1]] - points[pairs[:, 0]], axis=1) >= _SHORTEST_BONE_M
    return pairs[long]


def _radius(joint: str) -> float:
    name = joint.lower()
    return next((radius for parts, radius in _RADII if any(part in name for part in parts)), _OTHER_RADIUS)


def _texture(person: Person, radius: float) -> Texture:
    if radius == people.LEG_RADIUS:
        return person.trousers
    return (
        person.shirt
        if radius in (people.TORSO_RADIUS, people.UPPER_ARM_RADIUS, people.SHOULDER_RADIUS)
        else person.skin
    )
