"""What every method is given and what it gives back."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

from twin_node.bench.methods.truth import Follow
from twin_node.model import ModelParameters
from twin_node.model.sequence import HashParameters, HexPlaneParameters, Recording
from twin_node.scene import Camera, Float32


@dataclass(frozen=True)
class NerfParameters:
    """Size of the dynamic NeRF and of its training."""

    steps: int = 2000
    rays: int = 512
    """Per step; half of them where something moves, as in Neural 3D Video."""
    samples: int = 48
    """Per ray."""
    resolution: int = 48
    """Cells of a plane along each axis, at the coarser of two levels."""
    features: int = 12
    """Channels of a plane."""
    hidden: int = 32
    """Width of the decoder."""


@dataclass(frozen=True)
class Budget:
    """What the methods may spend; one budget for all methods of a run."""

    gaussians: int = 4000
    """At most, of any method but the online one, whose capacity follows its own parameters."""
    offline_steps: int = 3000
    """Of 4DGS with the field; `gain_of_last_fifth_db` beside its scores tells how flat its plateau is."""
    per_frame_steps: int = 120
    """Of per-frame 3DGS, for each set of images from scratch."""
    stream_steps: int = 60
    """Of each of the two stages of the streaming method, per set; 150 and 100 as published, at ten times the width."""
    hexplane: HexPlaneParameters = field(default_factory=lambda: HexPlaneParameters(resolution=32))
    """Half as fine as published: for images of a tenth of the published width."""
    hash: HashParameters = field(default_factory=lambda: HashParameters(levels=6, finest=64))
    nerf: NerfParameters = field(default_factory=NerfParameters)
    online: ModelParameters = field(default_factory=ModelParameters)
    seed: int = 0


QUICK = Budget(
    gaussians=3000,
    offline_steps=150,
    per_frame_steps=30,
    stream_steps=10,
    hexplane=HexPlaneParameters(resolution=32, hidden=32),
    hash=HashParameters(levels=6, features=2, log2_entries=13, hidden=32),
    nerf=NerfParameters(steps=150, rays=512, samples=32, resolution=32, features=8, hidden=32),
)
"""A minute for all methods on two cores at the size of `MADE_UP_QUICK`: shows that all run, not what they reach."""

Progress = Callable[[float], None]
"""Called with the share of its work that a method has done, 0 to 1."""


@dataclass(frozen=True)
class Fitted:
    """A scene as a method has learnt it."""

    render: Callable[[Camera, int], Float32 | None]
    """[H, W, 3] 0 to 1: what a camera sees at a stamp (ns) of the recording; None where there is nothing to show."""
    follow: Follow
    parameters: int | None
    """Learned numbers that describe the whole sequence; None where nothing is learnt."""
    bytes: int | None
    """Of all that has to be kept to play the sequence; None where nothing is."""
    notes: dict[str, float] = field(default_factory=dict)
    """Figures of this method alone."""


@dataclass(frozen=True)
class Method:
    """One way to a dynamic scene."""

    title: str
    fit: Callable[[Recording, Budget, Progress], Fitted]
    online: bool
    """Whether it knows, at each time, the images up to then alone."""
    takes_steps: bool = False
    """Whether the budget's `offline_steps` say how long it learns."""
