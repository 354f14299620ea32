"""What can be set in sequence training, with defaults that work on two CPU cores at small sizes."""

from __future__ import annotations

from dataclasses import dataclass, field

from twin_node.model.parameters import ModelError
from twin_node.model.sequence.hash_mlp import HashParameters
from twin_node.model.sequence.hex_plane import HexPlaneParameters
from twin_node.ranges import Range, check_ranges

SEEDS, COUNTS = Range(0, 2**63 - 1), Range(1)
METHODS = ("hexplane", "hash", "static")
"""Fields: planes, a hash grid, or none at all (a static model of the mean over time)."""


@dataclass(frozen=True)
class RateParameters:
    """Adam's rates; those of the Gaussians are the published ones of 3DGS, means in units of the scene's extent."""

    means: float = 1.6e-4
    means_final: float = 1.6e-6
    quats: float = 1e-3
    log_scales: float = 5e-3
    logits: float = 5e-2
    colours: float = 2.5e-3
    harmonics: float = 1.25e-4
    """Of the coefficients above the constant: a twentieth of the colours'."""
    grid: float = 3e-2
    """Planes or table. Published: 1.6e-3, for ten times as many steps (at 1e-2, 0.6 dB less on moving pixels)."""
    grid_final: float = 3e-3
    decoder: float = 3e-3
    """Heads. Published: 1.6e-4, for the same reason."""
    decoder_final: float = 3e-4


@dataclass(frozen=True)
class DensifyParameters:
    """When Gaussians are cloned, split and pruned: 3DGS (Kerbl et al., TOG 2023, section 5), for short runs."""

    begin: float = 0.1
    """Share of all steps after which it begins."""
    end: float = 0.6
    """Share of all steps after which it ends."""
    interval: int = 100
    """Steps from one time to the next."""
    gradient: float = 5e-4
    """Mean gradient of the position in the image (in half widths) above which a Gaussian is too few. Published: 2e-4;
    with few Gaussians allowed, places that are pulled at hardest have to get them (+ 0.5 dB on held-out cameras)."""
    small: float = 0.01
    """Largest scale, in units of the extent, that is cloned; larger ones are split, as published."""
    faintest: float = 0.005
    """Opacity below which a Gaussian is pruned, as published."""
    largest: float = 0.5
    """Scale in units of the extent above which a Gaussian is pruned; 0.1 as published, where no background surrounds
    the cameras."""
    reset_interval: int = 3000
    """Steps from one reset of the opacities to the next, as published."""
    reset_opacity: float = 0.01


@dataclass(frozen=True)
class TrainParameters:
    """How a recording becomes a sequence model."""

    method: str = "hexplane"
    """One of `METHODS`."""
    device: str = "cpu"
    """Torch device that all of it happens on."""
    steps: int = 3000
    """Steps with the field. Published: 14,000 for 300 frames of 20 cameras."""
    coarse_share: float = 0.2
    """Steps before it without the field, as a share of `steps`: 3000 of 14,000 as published."""
    batch: int = 2
    """Images per step."""
    degree: int = 1
    """Degree of the harmonics: colour by direction."""
    start_gaussians: int = 8000
    """Gaussians at the start, at most."""
    most_gaussians: int = 20_000
    """Gaussians that densification may lead to."""
    l1: float = 0.8
    ssim: float = 0.2
    """Weight of 1 - SSIM beside L1, as in 3DGS; 4DGS was published with L1 alone."""
    seed: int = 0
    rates: RateParameters = field(default_factory=RateParameters)
    densify: DensifyParameters = field(default_factory=DensifyParameters)
    hexplane: HexPlaneParameters = field(default_factory=HexPlaneParameters)
    hash: HashParameters = field(default_factory=HashParameters)

    def __post_init__(self) -> None:
        if self.method not in METHODS:
            raise ModelError(f"method: expected one of {', '.join(METHODS)}, found '{self.method}'")
        if self.steps < 1 or self.batch < 1 or not 0 <= self.degree <= 3:
            raise ModelError(
                "training: expected steps and batch of 1 or more and a degree from 0 to 3, "
                f"found {self.steps}, {self.batch} and {self.degree}"
            )
        check_ranges(self, ModelError, "training: ", seed=SEEDS, start_gaussians=COUNTS, most_gaussians=COUNTS)

    @property
    def coarse_steps(self) -> int:
        """Steps before the field is switched on."""
        return 0 if self.method == "static" else round(self.coarse_share * self.steps)

    @property
    def all_steps(self) -> int:
        """Both stages."""
        return self.coarse_steps + self.steps
