"""What the model makes of images: Gaussians, the nodes that move them, and the light they were seen in."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import numpy as np
from numpy.typing import NDArray

from twin_node.scene.arrays import Bool, Float32, Float64, UInt8, UInt32
from twin_node.scene.images import FrameSet


class Tier(IntEnum):
    """The simplest motion model that explains a Gaussian."""

    STATIC = 0
    ROBOT = 1
    RIGID = 2
    DEFORMABLE = 3
    TRANSIENT = 4


@dataclass(frozen=True)
class GaussianCloud:
    """Gaussians as they are at one time, in `base_link`."""

    means: Float32
    """[N, 3] m."""
    quats: Float32
    """[N, 4] w, x, y, z, of length 1."""
    scales: Float32
    """[N, 3] m, linear."""
    opacities: Float32
    """[N] 0 to 1, linear."""
    rgb: Float32
    """[N, 3] 0 to 1."""
    velocities: Float32
    """[N, 3] m/s; zero for STATIC."""
    tiers: UInt8
    """[N] values of `Tier`."""
    ids: UInt32
    """[N] stable for as long as a Gaussian lives."""
    nodes: NDArray[np.int32]
    """[N] row in `NodeStates` of the node that carries it, -1 for none."""

    @classmethod
    def none(cls) -> GaussianCloud:
        """No Gaussian at all."""
        three, four, one = (np.zeros((0, width), np.float32) for width in (3, 4, 1))
        tiers, ids = np.zeros(0, np.uint8), np.zeros(0, np.uint32)
        return cls(three, four, three, one[:, 0], three, three, tiers, ids, np.zeros(0, np.int32))

    def only(self, chosen: Bool | NDArray[np.integer]) -> GaussianCloud:
        """The chosen Gaussians: a mask [N], or rows in the order wanted."""
        rows = np.flatnonzero(chosen) if chosen.dtype == np.bool_ else chosen  # once, not for every attribute
        return GaussianCloud(**{name: values.take(rows, 0) for name, values in vars(self).items()})

    def moved(self, seconds: float) -> GaussianCloud:
        """These Gaussians some seconds later, or before, at their velocities; they do not turn."""
        return replace(self, means=self.means + self.velocities * np.float32(seconds))

    def joined(self, other: GaussianCloud) -> GaussianCloud:
        """These Gaussians and then the other's, whose `nodes` must be rows of the same `NodeStates`."""
        return GaussianCloud(**{name: np.concatenate([own, vars(other)[name]]) for name, own in vars(self).items()})


@dataclass(frozen=True)
class NodeStates:
    """Motion nodes: the frames that moving Gaussians live in."""

    ids: UInt32
    """[M] stable for as long as a node lives."""
    positions: Float64
    """[M, 3] m, the centroid of the Gaussians it carries."""
    quats: Float64
    """[M, 4] w, x, y, z, rotation since birth."""
    velocities: Float64
    """[M, 3] m/s."""
    angular_velocities: Float64
    """[M, 3] rad/s, in `base_link`."""
    sigmas: Float64
    """[M] 1 sigma of the position, m."""
    radii: Float64
    """[M] radius of the sphere about `positions` that holds the means of the Gaussians it carries, m."""

    @classmethod
    def none(cls) -> NodeStates:
        """No node at all."""
        three, one = np.zeros((0, 3)), np.zeros(0)
        return cls(np.zeros(0, np.uint32), three, np.zeros((0, 4)), three, three, one, one)


@dataclass(frozen=True)
class Exposure:
    """How a camera is exposed beside the light of the model's first set."""

    gains: Float32
    """[3] per colour, what a colour is multiplied by."""
    offsets: Float32
    """[3] what is added then, of colours from 0 to 1."""

    @property
    def is_plain(self) -> bool:
        """Whether the camera shows colours as the model has them."""
        return bool((self.gains == 1).all() and (self.offsets == 0).all())

    @property
    def brightness(self) -> float:
        """The middle of the gains: 1 as bright as the model, 0.5 half as bright."""
        return float(np.median(self.gains))

    def of(self, rgb: Float32) -> Float32:
        """[..., 3] what the camera shows of colours [..., 3] of the model, 0 to 1."""
        shown: Float32 = np.clip(rgb * self.gains + self.offsets, 0, 1)
        return shown


PLAIN = Exposure(np.ones(3, np.float32), np.zeros(3, np.float32))
"""The exposure of the model's first set."""


@dataclass(frozen=True)
class TwinState:
    """The model at the stamp of its evidence."""

    stamp: int
    """Evidence, ns."""
    frames: FrameSet
    """The images that it was brought up to date with, levelled to the light of the first set: see `exposures`."""
    gaussians: GaussianCloud
    nodes: NodeStates
    moving_masks: tuple[Bool, ...]
    """Per view of `frames`: [H, W] True where the image shows something that moves or has moved (robot left out)."""
    robot_masks: tuple[Bool | None, ...]
    """Per view: [H, W] True on the arm and its margin; None where the arm's joints are unknown."""
    warnings: tuple[str, ...] = ()
    exposures: tuple[Exposure, ...] = ()
    """Per view how its camera was exposed; empty: all as the model is."""
    followed: int | None = None
    """Stamp (ns) of the set that Gaussians and nodes follow, where that is an older one; None: they follow this one."""
    depth_noise: tuple[float, ...] = ()
    """Per view 1 sigma of its camera's depth at 1 m, m, growing with the square of the depth, as measured; 0 where that
    is not known. Empty: of none."""

    @property
    def model_stamp(self) -> int:
        """Stamp of the set that Gaussians and nodes follow, ns."""
        return self.stamp if self.followed is None else self.followed

    def depth_noise_of(self, camera: str) -> float:
        """1 sigma of a camera's depth at 1 m, m; 0 where that is not known."""
        known = zip(self.frames.views, self.depth_noise, strict=False)
        return next((noise for view, noise in known if view.camera.name == camera), 0.0)

    def exposure_of(self, camera: str) -> Exposure:
        """How a camera was exposed; `PLAIN` where that is not known."""
        known = zip(self.frames.views, self.exposures, strict=False)
        return next((exposure for view, exposure in known if view.camera.name == camera), PLAIN)
