"""The constants of gsplat's rasteriser that this room shares; those that differ between its versions in one place."""

from __future__ import annotations

import re
from dataclasses import dataclass
from functools import cache
from importlib import metadata

ALPHA_THRESHOLD = 1 / 255
"""Alpha below which a Gaussian is not drawn (Common.h)."""

TRANSMITTANCE_CUT = 1e-4
"""A pixel is finished before the Gaussian that would take its transmittance here (RasterizeToPixels3DGSFwd.cu)."""

EXTENT_SIGMAS = 3.33
"""Standard deviations that a Gaussian reaches at most, for culling (ProjectionEWA3DGSFused.cu)."""

SMALLEST_ALPHA = 1e-10
"""Expected depth is depth / max(alpha, this) (rendering.py)."""


@dataclass(frozen=True)
class Semantics:
    """What a version of gsplat does at the edges."""

    max_alpha: float
    """Alpha is clamped here, with no gradient above."""
    min_compensation: float
    """Smallest opacity factor in antialiased mode."""


GSPLAT_1_5 = Semantics(max_alpha=0.999, min_compensation=0.0)
GSPLAT_1_6 = Semantics(max_alpha=0.99, min_compensation=0.005)


def semantics_of(version: str) -> Semantics:
    """Constants of a gsplat version such as `1.5.3`, `1.6rc1` or `2`."""
    numbers = tuple(int(number) for number in re.findall(r"\d+", version.partition("+")[0])[:2])
    return GSPLAT_1_6 if numbers >= (1, 6) else GSPLAT_1_5


@cache
def installed_semantics() -> Semantics:
    """Constants of the installed gsplat, so that all backends agree; of 1.5 where there is none."""
    try:
        return semantics_of(metadata.version("gsplat"))
    except metadata.PackageNotFoundError:
        return GSPLAT_1_5
