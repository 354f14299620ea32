"""What can be set in the window model, with defaults that work, and the error that its inputs can cause."""

from __future__ import annotations

from dataclasses import dataclass, field

from twin_node.errors import TwinError
from twin_node.ranges import NOT_NEGATIVE, POSITIVE, SHARE, Range, check_ranges


class ModelError(TwinError):
    """The window model was given something that it cannot work with."""


_COUNT = Range(0, 1_000_000)
"""Steps, births: none, or more than anyone waits for."""


@dataclass(frozen=True)
class SeedParameters:
    """How the first set of images becomes Gaussians."""

    steps: int = 120
    """Optimisation steps on the first set."""
    stride_px: int = 2
    """One Gaussian per block of this many pixels squared and camera, before those of the same place are merged."""
    levels: int = 96
    """Depths that are tried per pixel where none is measured."""
    shell_factor: float = 2.5
    """Radius of the background shell in units of the farthest camera's distance from what the rig looks at; to each
    camera it is as large as twice its own at least."""

    def __post_init__(self) -> None:
        """Raises `ModelError` for a number that is none of its kind."""
        check_ranges(
            self,
            ModelError,
            "model: seed.",
            steps=_COUNT,
            stride_px=Range(1, 1024),
            levels=Range(3, 4096),
            shell_factor=POSITIVE,
        )


@dataclass(frozen=True)
class TrackParameters:
    """How the moving part follows the images."""

    alignments: int = 1
    """Gauss-Newton passes that turn the flow from rendering to image into node motion."""
    steps: int = 3
    """Gradient steps per set on the Gaussians that move, for a set that has time for all: time traded for quality."""
    latency_ms: float = 33.0
    """Wished for from a set's newest image to its state. Live, a set that would be later takes fewer steps, where that
    helps and few are late; 0: never. In lockstep nothing is late, and in a process of its own nothing is hurried."""
    learning_rate: float = 4.0
    """Multiplies all rates of `descending.RATES`."""
    selects: bool = True
    """False: what stands still takes the gradient steps too, on whole images, as methods do that select nothing."""
    bends: bool = True
    """False: nodes stay RIGID, whatever the evidence; the deformation field is never used."""
    velocity_damping: float = 1.0
    """Share of a node's velocity that the prediction of the next set keeps."""

    def __post_init__(self) -> None:
        """Raises `ModelError` for a number that is none of its kind."""
        check_ranges(
            self,
            ModelError,
            "model: track.",
            alignments=_COUNT,
            steps=_COUNT,
            latency_ms=NOT_NEGATIVE,
            learning_rate=POSITIVE,
            velocity_damping=SHARE,
        )


@dataclass(frozen=True)
class BirthParameters:
    """When Gaussians and nodes are born and die."""

    per_set: int = 200
    """Gaussians born per set at most; more where sets are more than 1/15 s apart, by as much as they are."""
    moving_share: float = 0.0625
    """Share of the capacity that Gaussians which are not STATIC may take: one per six pixels where an eighth moves.
    More than twice as many are worth 0.1 to 0.3 dB of what moves in a recorded cell, 0.9 where a quarter of all pixels
    moves, and cost a tenth of the sets."""
    node_members: int = 8
    """Gaussians that a new node needs."""
    transient_s: float = 0.5
    """Life of a TRANSIENT: by then a node carries what it stood for, or the background has learnt it. Where depth is
    measured and that is not so, it has six lives."""
    stale_s: float = 0.15
    """The background is learnt anew where it has been wrong for this long and nothing moves."""

    def __post_init__(self) -> None:
        """Raises `ModelError` for a number that is none of its kind."""
        check_ranges(
            self,
            ModelError,
            "model: birth.",
            per_set=_COUNT,
            moving_share=SHARE,
            node_members=Range(1),
            transient_s=NOT_NEGATIVE,
            stale_s=NOT_NEGATIVE,
        )


@dataclass(frozen=True)
class MapParameters:
    """How what stands still is refined beside the tracking."""

    steps: int = 2
    """Steps per set, and one where sets have waited of late; 0: STATIC Gaussians keep the shape that the first set gave
    them."""
    tries: int = 30
    """Looks at a pixel, one per camera in turn, after which what steps have left over is taken for all that can be."""
    calm_s: float = 0.15
    """For how long a pixel must have been free and still before what it shows is learnt."""
    patience_s: float = 0.5
    """For how long a pixel must have been at rest before what steps have not made good is given new Gaussians."""
    most_born: int = 40
    """Gaussians born per set at most."""

    def __post_init__(self) -> None:
        """Raises `ModelError` for a number that is none of its kind."""
        check_ranges(
            self,
            ModelError,
            "model: map.",
            steps=_COUNT,
            tries=_COUNT,
            calm_s=NOT_NEGATIVE,
            patience_s=NOT_NEGATIVE,
            most_born=_COUNT,
        )


@dataclass(frozen=True)
class ModelParameters:
    """Parameters of `WindowModel`."""

    device: str = "cpu"
    """Torch device that the Gaussians live on."""
    own_process: bool = True
    """In real time sets are followed in a process of its own, where there are two processors or more: the arm is told
    of a sixth to a half more sets, for some 400 MB. In lockstep never."""
    gaussians_per_pixel: float = 0.3
    """Capacity in Gaussians per pixel of a set; fixed at the first set."""
    most_gaussians: int = 24_000
    """Capacity that larger images do not raise further: what two CPU cores follow at several sets per second."""
    nodes: int = 64
    """Capacity in motion nodes."""
    window: int = 32
    """Sets that the window holds: node poses and time columns of the field."""
    seed: SeedParameters = field(default_factory=SeedParameters)
    track: TrackParameters = field(default_factory=TrackParameters)
    birth: BirthParameters = field(default_factory=BirthParameters)
    map: MapParameters = field(default_factory=MapParameters)

    def __post_init__(self) -> None:
        """Raises `ModelError` for room for nothing, and for more than any machine has room for."""
        check_ranges(
            self,
            ModelError,
            "model: ",
            gaussians_per_pixel=Range(0, 100, above=True),
            most_gaussians=Range(1, 10_000_000),
            nodes=Range(1, 10_000),
            window=Range(2, 10_000),
        )
