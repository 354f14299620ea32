"""Biovision `.bvh` motion capture files: a skeleton of joints and where they are in every frame."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from twin_node.bag.log import BagError
from twin_node.bag.trajectories import Trajectories, checked
from twin_node.scene import Float64

_MOST_FRAMES = 1_000_000
"""More than two hours at 120 Hz: a larger count is a damaged file."""
_CHANNELS = {f"{axis}{kind}": (kind, axis) for axis in "XYZ" for kind in ("position", "rotation")}


@dataclass(frozen=True)
class BvhJoint:
    """One joint, or the end of a limb, as the file describes it."""

    name: str
    parent: int
    """Row of the parent; -1 for a root."""
    offset: tuple[float, float, float]
    """From the parent where the channels say nothing, in the file's unit."""
    channels: tuple[str, ...]
    """`Xposition` to `Zrotation` in the file's order."""
    is_end: bool
    """An end site: it gives the last bone its length and is no joint."""


@dataclass(frozen=True)
class BvhClip:
    """A recorded motion: joint positions in the file's own frame (y up) and unit."""

    joints: tuple[BvhJoint, ...]
    frame_s: float
    """Time between two frames, s."""
    positions: Float64
    """[T, J, 3]."""

    @property
    def duration_s(self) -> float:
        """From the first frame to the last, s."""
        return (len(self.positions) - 1) * self.frame_s


def read_clip(path: Path) -> BvhClip:
    """Reads a BVH file (Biovision hierarchy: https://research.cs.wisc.edu/graphics/Courses/cs-838-1999/Jeff/BVH.html).

    Rotations are taken in the order of the channels, in degrees; position channels take the place of the joint's
    offset. Raises `BagError` with the line for a file that is no BVH, or that ends before its frames do.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise BagError(f"{path}: expected a readable BVH file, {error}; check the path") from error
    words = _Words(path, text)
    joints = _read_hierarchy(words)
    frames = words.whole("Frames:")
    words.expect("Frame")
    frame_s = words.number("Time:")
    channels = sum(len(joint.channels) for joint in joints)
    if not 0 < frames <= _MOST_FRAMES or not frame_s > 0:
        raise BagError(f"{path}: expected frames and a frame time above 0, found {frames} and {frame_s}")
    values = words.rest()
    if len(values) != frames * channels:
        raise BagError(
            f"{path}: expected {frames} frames of {channels} numbers after 'Frame Time:', found {len(values)} numbers; "
            "the file is cut off or of another skeleton"
        )
    return BvhClip(tuple(joints), frame_s, _place(joints, values.reshape(frames, channels)))


def read_bvh(path: Path, height_m: float) -> Trajectories:
    """Joint positions of a BVH file, scaled so that the person is `height_m` tall; axes as in the file (y up).

    The person's height is the median over time of the vertical extent of all joints and ends: mostly upright is
    assumed. Raises `BagError` as `read_clip` does, and for a skeleton without height.
    """
    clip = read_clip(path)
    extent = float(np.median(np.ptp(clip.positions[:, :, 1], axis=1)))
    if not extent > 0:
        raise BagError(f"{path}: expected a skeleton with a height (y up), found one of height {extent}")
    chosen = [row for row, joint in enumerate(clip.joints) if not joint.is_end]
    names = tuple(clip.joints[row].name for row in chosen)
    times: Float64 = clip.frame_s * np.arange(len(clip.positions), dtype=np.float64)
    return checked(path, names, times, clip.positions[:, chosen] * (height_m / extent))


@dataclass
class _Words:
    """The file's words in turn, each with its line for errors."""

    path: Path
    text: str
    words: list[str] = field(init=False)
    lines: list[int] = field(init=False)
    next: int = 0

    def __post_init__(self) -> None:
        pairs = [(word, row) for row, line in enumerate(self.text.splitlines(), 1) for word in line.split()]
        self.words = [word for word, _ in pairs]
        self.lines = [row for _, row in pairs]

    def peek(self) -> str:
        """The next word, left where it is; empty at the end."""
        return self.words[self.next] if self.next < len(self.words) else ""

    def take(self, wanted: str) -> str:
        """The next word, whatever it is; `wanted` says what for."""
        if self.next >= len(self.words):
            raise BagError(f"{self.path}: expected {wanted}, found the end of the file; is it a whole BVH file?")
        self.next += 1
        return self.words[self.next - 1]

    def expect(self, *words: str) -> str:
        """The next word, which must be one of these."""
        found = self.take(" or ".join(words))
        if found not in words:
            raise self.error(" or ".join(words), found)
        return found

    def number(self, name: str | None = None) -> float:
        """The next number; after its name, if it has one."""
        if name is not None:
            self.expect(name)
        found = self.take("a number")
        try:
            value = float(found)
        except ValueError:
            raise self.error("a number", found) from None
        if not np.isfinite(value):
            raise self.error("a finite number", found)
        return value

    def whole(self, name: str | None = None) -> int:
        """The next number, which must be whole."""
        value = self.number(name)
        if value != int(value):
            raise self.error("a whole number", str(value))
        return int(value)

    def rest(self) -> Float64:
        """All numbers that are left."""
        try:
            values = np.array(self.words[self.next :], dtype=np.float64)
        except ValueError as error:
            raise BagError(f"{self.path}: expected only numbers after 'Frame Time:', {error}") from None
        if not np.isfinite(values).all():
            raise BagError(f"{self.path}: expected finite numbers after 'Frame Time:', found NaN or infinity")
        return values

    def error(self, expected: str, found: str) -> BagError:
        """What to raise for the word taken last."""
        line = self.lines[self.next - 1]
        return BagError(f"{self.path}: line {line}: expected {expected}, found '{found}'; is it a BVH file?")


def _read_hierarchy(words: _Words) -> list[BvhJoint]:
    """All joints, each parent before its children."""
    words.expect("HIERARCHY")
    joints: list[BvhJoint] = []
    open_rows: list[int] = []
    word = words.expect("ROOT")
    while word != "MOTION":
        if word == "}":
            open_rows.pop()
        else:
            parent = open_rows[-1] if open_rows else -1
            label = words.take("a joint's name")
            open_rows.append(len(joints))
            is_end = word == "End"
            joints.append(_read_joint(words, f"{joints[parent].name}End" if is_end else label, parent, is_end))
        word = words.expect(*(("JOINT", "End", "}") if open_rows else ("ROOT", "MOTION")))
    return joints


def _read_joint(words: _Words, name: str, parent: int, is_end: bool) -> BvhJoint:
    """A joint's own lines, up to what hangs on it."""
    words.expect("{")
    words.expect("OFFSET")
    offset = (words.number(), words.number(), words.number())
    channels: tuple[str, ...] = ()
    if words.peek() == "CHANNELS":
        words.expect("CHANNELS")
        channels = tuple(words.expect(*_CHANNELS) for _ in range(words.whole()))
    return BvhJoint(name, parent, offset, channels, is_end)


def _place(joints: list[BvhJoint], values: Float64) -> Float64:
    """Positions [T, J, 3] of all joints from the channels' values [T, C]."""
    positions = np.empty((len(values), len(joints), 3))
    turns: list[Rotation] = []
    column = 0
    for row, joint in enumerate(joints):
        own = values[:, column : column + len(joint.channels)]
        column += len(joint.channels)
        local = np.tile(np.array(joint.offset, dtype=np.float64), (len(values), 1))
        turn = Rotation.identity(len(values))
        for channel, value in zip(joint.channels, own.T, strict=True):
            kind, axis = _CHANNELS[channel]
            if kind == "position":
                local[:, "XYZ".index(axis)] = value
            else:
                turn = turn * Rotation.from_euler(axis, value[:, None], degrees=True)
        if joint.parent < 0:
            positions[:, row] = local
            turns.append(turn)
        else:
            positions[:, row] = positions[:, joint.parent] + turns[joint.parent].apply(local)
            turns.append(turns[joint.parent] * turn)
    return positions
