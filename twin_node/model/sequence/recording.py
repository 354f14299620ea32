"""A whole recording in memory: what sequence training and the table of methods work on."""

from __future__ import annotations

import bisect
import itertools
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_node.model.first_light import FirstLight, is_blind, once_lit
from twin_node.model.parameters import ModelError
from twin_node.model.sweep import shell_around
from twin_node.scene import Camera, Float32, Float64, FrameSet, View

EXTENT_MARGIN = 1.1
"""How much farther than its farthest camera a scene reaches (Kerbl et al., TOG 2023)."""
ONE_PLACE = 1e-3
"""Cameras that are this near to each other, as a share of what they look at, stand in one place."""
COARSEST = 1e-4
"""How far apart places may be that float32 tells apart, as a share of what cameras look over: a tenth of a pixel."""

MOST_BYTES = 8 * 2**30
"""Of images, all of which are held as long as something is learnt of them."""


@dataclass(frozen=True)
class ColouredPoints:
    """Points that a scene may start from."""

    positions: Float64
    """[P, 3] m."""
    rgb: Float32
    """[P, 3] 0 to 1."""


@dataclass(frozen=True)
class Recording:
    """Images with cameras and times, those to learn from and those to be scored on."""

    name: str
    """What messages call it: the file or folder it came from."""
    train: tuple[View, ...]
    """In rising order of stamps."""
    held_out: tuple[View, ...] = ()
    """In rising order of stamps; never trained on."""
    points: ColouredPoints | None = None
    """What is known of the scene's surfaces, where anything is."""
    background: tuple[float, float, float] = (0.0, 0.0, 0.0)
    """Red, green, blue, 0 to 1, where nothing is."""
    camera_moves: bool = False
    """Whether every image has a camera of its own; else those of one name stand still."""

    def __post_init__(self) -> None:
        if not self.train:
            raise ModelError(f"{self.name}: expected images to train on, found none; check --hold-out and --frames")
        for camera in {id(view.camera): view.camera for view in (*self.train, *self.held_out)}.values():
            if not _is_float32(camera.K):
                raise ModelError(
                    f"{self.name}: expected intrinsics that float32 holds of camera {camera.name}, found "
                    f"{camera.K.tolist()}; calibrate it again"
                )
        points = self.points
        if points is not None and not (_is_float32(points.positions) and _is_float32(points.rgb)):
            raise ModelError(f"{self.name}: expected points of finite positions and colours; remove those that are not")

    @property
    def first(self) -> int:
        """Stamp of the first training image, ns."""
        return self.train[0].stamp

    @property
    def last(self) -> int:
        """Stamp of the last training image, ns."""
        return self.train[-1].stamp

    @property
    def steps(self) -> int:
        """Time steps: how many sets the images make; the distinct times where the camera moves."""
        return len(self._by_step())

    @property
    def extent(self) -> float:
        """The cameras' reach about their centre, m, as 3DGS has it; the distance they look over where all stand in one
        place."""
        cameras = [view.camera for view in self.train]
        centres = np.stack([camera.T_base_cam[:3, 3] for camera in cameras])
        reach = float(np.linalg.norm(centres - centres.mean(0), axis=1).max())
        distance = shell_around(cameras, 1.0).radius
        return EXTENT_MARGIN * (reach if reach > ONE_PLACE * distance else distance)

    def check_places(self) -> None:
        """Raises `ModelError` where cameras are so far from the origin that float32 cannot tell places apart there."""
        farthest = max(float(np.abs(view.camera.T_base_cam[:3, 3]).max()) for view in self.train)
        spacing = float(np.finfo(np.float32).eps) * farthest
        distance = shell_around([view.camera for view in self.train], 1.0).radius
        if not spacing <= COARSEST * distance:
            raise ModelError(
                f"{self.name}: expected cameras near the origin, found one {farthest:.3g} m away, where float32 holds "
                f"places to {spacing:.2g} m only, in a scene of {distance:.2g} m; move the scene there"
            )

    def sets(self) -> list[FrameSet]:
        """The training images as sets, in rising order of stamps: each has one image of a camera at most, and begins
        where one camera has its next; a set per time, if the camera moves."""
        steps = enumerate(self._by_step())
        return [FrameSet(max(view.stamp for view in views), tuple(views), sequence=i) for i, views in steps]

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """One per name among the training images, as it was first."""
        return tuple({view.camera.name: view.camera for view in reversed(self.train)}.values())[::-1]

    def _by_step(self) -> list[list[View]]:
        """The training images of each time step."""
        if self.camera_moves:
            return [list(views) for _, views in itertools.groupby(self.train, lambda view: view.stamp)]
        steps: list[list[View]] = []
        shown: set[str] = set()
        for view in self.train:
            if not steps or view.camera.name in shown:
                steps.append([])
                shown.clear()
            steps[-1].append(view)
            shown.add(view.camera.name)
        return steps


def recording_of(
    name: str, sets: Iterable[FrameSet], hold_out: Sequence[str] = (), frames: int | None = None
) -> Recording:
    """Sets of a log, a rig or a simulated cell; cameras `hold_out` are kept for scoring, `frames` sets taken.

    Images that cameras began with, black or burnt out, are left out.

    Raises `ModelError` where a camera to hold out is not there, nothing is left to train on, or as soon as images are
    more than `MOST_BYTES`.
    """
    light = FirstLight()
    lit = (light.heed(one).views for one in itertools.islice(once_lit(sets), frames))
    views = list(that_fit(name, (view for shown in lit for view in shown if not is_blind(view))))
    return split(Recording(name, in_order(views)) if views else _empty(name), hold_out)


def that_fit(name: str, views: Iterable[View]) -> Iterator[View]:
    """The views of a recording as they are read. Raises `ModelError` as soon as images are more than `MOST_BYTES`."""
    size = 0
    for count, view in enumerate(views, 1):
        size += view.rgb.nbytes + (0 if view.depth is None else view.depth.nbytes)
        if size > MOST_BYTES:
            raise ModelError(
                f"{name}: expected images of at most {MOST_BYTES / 2**30:g} GiB, found more in the first {count}; take "
                "fewer with --frames, or smaller ones with --width"
            )
        yield view


def split(recording: Recording, hold_out: Sequence[str]) -> Recording:
    """The recording with the images of cameras `hold_out` kept for scoring instead of training.

    Raises `ModelError` where there is no such camera, or nothing is left to train on.
    """
    names = sorted({view.camera.name for view in (*recording.train, *recording.held_out)})
    for name in hold_out:
        if name not in names:
            raise ModelError(
                f"{recording.name}: expected a camera to hold out among {_listed(names)}, found no '{name}'"
            )
    kept = tuple(view for view in recording.train if view.camera.name not in hold_out)
    hidden = tuple(view for view in recording.train if view.camera.name in hold_out)
    return replace(recording, train=kept, held_out=in_order([*recording.held_out, *hidden]))


def in_order(views: Iterable[View]) -> tuple[View, ...]:
    """Views in rising order of stamps; those of one stamp stay in their order."""
    return tuple(sorted(views, key=lambda view: view.stamp))


def nearest(stamps: Sequence[int], stamp: int) -> int:
    """Index of the stamp in a rising, non-empty sequence that is nearest to another, the earlier of two."""
    after = bisect.bisect_left(stamps, stamp)
    if after == 0:
        return 0
    if after == len(stamps) or stamp - stamps[after - 1] <= stamps[after] - stamp:
        return after - 1
    return after


def _is_float32(values: Float64 | Float32) -> bool:
    """Whether all are finite in float32, which they become."""
    return not len(values) or bool(np.abs(values).max() <= np.finfo(np.float32).max)


def _empty(name: str) -> Recording:
    raise ModelError(f"{name}: expected sets of images that show something, found none; check topics and light")


def _listed(names: Sequence[str]) -> str:
    return ", ".join(names[:8]) + (f" and {len(names) - 8} more" if len(names) > 8 else "")
