"""Procedural surface patterns: solid textures, so that every surface has features that stay on it as it moves."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cache

import numpy as np

from twin_node.cell.errors import CellError
from twin_node.scene import Float32

LATTICE = 128
"""Side of the periodic noise volume in cells, a power of two."""
GRAIN = 4.0
"""Cells of the grain that every pattern has, per element."""
JOINT = 0.03
"""Half the width of the joints between tiles, in tiles."""
SHADES = 0.4
"""Share of the second colour that a tile has at most."""
WOOD_GRAIN = (0.12, 0.4, 0.4)
"""Cells, along x, y and z, of what distorts the rings of wood, per element: they are long along x."""
WOOD_DISTORTION, WOOD_RINGS = 2.0, 4.0
"""In elements; radians per element."""


@dataclass(frozen=True)
class Texture:
    """Two colours and the pattern that mixes them."""

    pattern: str = "speckle"
    """One of `PATTERNS`."""
    color: tuple[int, int, int] = (150, 150, 150)
    """R, G, B from 0 to 255."""
    color2: tuple[int, int, int] = (110, 110, 110)
    """The pattern's second colour."""
    scale_m: float = 0.05
    """Size of the pattern's elements, m."""

    def __post_init__(self) -> None:
        if self.pattern not in PATTERNS:
            raise CellError(f"texture: pattern must be one of {', '.join(PATTERNS)}, found '{self.pattern}'")
        if not self.scale_m > 0:
            raise CellError(f"texture: scale_m must be positive, found {self.scale_m}")
        for name in ("color", "color2"):
            if not all(0 <= level <= 255 for level in getattr(self, name)):
                raise CellError(
                    f"texture: {name} must be red, green and blue from 0 to 255, found {list(getattr(self, name))}"
                )


def colors(texture: Texture, points: Float32) -> Float32:
    """Colours [3, n], 0 to 255, at points [3, n] in metres in the frame of the textured shape."""
    first = np.array(texture.color, np.float32)[:, None]
    second = np.array(texture.color2, np.float32)[:, None]
    return first + _weight(texture, points) * (second - first)


def _weight(texture: Texture, points: Float32) -> Float32:
    """Share [n] of the second colour."""
    cells = points / np.float32(texture.scale_m)
    share, figure = _FIGURES[texture.pattern]
    weight: Float32 = np.float32(share) * figure(cells) + np.float32(1 - share) * _noise(cells * np.float32(GRAIN))
    return weight


def _plain(cells: Float32) -> Float32:
    return np.zeros(cells.shape[1], np.float32)


def _checker(cells: Float32) -> Float32:
    x, y, z = np.floor(cells)
    odd: Float32 = (x + y + z) % 2
    return odd


def _stripes(cells: Float32) -> Float32:
    x, y, z = cells
    odd: Float32 = np.floor(x + y + z) % 2
    return odd


def _tiles(cells: Float32) -> Float32:
    """Joints along x and y; tiles of slightly different shades."""
    joint = np.abs(cells[:2] - np.round(cells[:2])).min(axis=0) < np.float32(JOINT)
    return np.where(joint, np.float32(1), np.float32(SHADES) * _blocks(cells))


def _wood(cells: Float32) -> Float32:
    """Rings distorted by noise that is long along x, the grain."""
    distortion = np.float32(WOOD_DISTORTION) * _noise(cells * np.array(WOOD_GRAIN, np.float32)[:, None])
    angle = np.float32(WOOD_RINGS) * (cells[1] + distortion)
    rings: Float32 = 0.5 + 0.5 * np.sin(angle.astype(np.float64)).astype(np.float32)  # rounded alike by all libraries
    return rings


@cache
def random_volume() -> Float32:
    """[`LATTICE`, `LATTICE`, `LATTICE`] the random values, 0 to 1, at the corners of the cells of noise."""
    return np.random.default_rng(20240117).random((LATTICE,) * 3, dtype=np.float32)


def _blocks(cells: Float32) -> Float32:
    """A random value in 0 to 1 per unit cell."""
    i, j, k = np.floor(cells).astype(np.int32) % LATTICE
    value: Float32 = random_volume()[i, j, k]
    return value


def _noise(cells: Float32) -> Float32:
    """Value noise in 0 to 1: trilinear between random values at the corners of unit cells."""
    base = np.floor(cells)
    x, y, z = cells - base
    i, j, k = base.astype(np.int32) % LATTICE
    i1, j1, k1 = (i + 1) % LATTICE, (j + 1) % LATTICE, (k + 1) % LATTICE
    v = random_volume()
    near = (v[i, j, k] * (1 - z) + v[i, j, k1] * z) * (1 - y) + (v[i, j1, k] * (1 - z) + v[i, j1, k1] * z) * y
    far = (v[i1, j, k] * (1 - z) + v[i1, j, k1] * z) * (1 - y) + (v[i1, j1, k] * (1 - z) + v[i1, j1, k1] * z) * y
    value: Float32 = near * (1 - x) + far * x
    return value


_FIGURES: dict[str, tuple[float, Callable[[Float32], Float32]]] = {
    "plain": (0.9, _plain),
    "checker": (0.85, _checker),
    "stripes": (0.85, _stripes),
    "tiles": (0.8, _tiles),
    "wood": (0.55, _wood),
    "speckle": (0.5, _noise),
    "patches": (0.8, _blocks),
}
"""Per pattern, the figure's share of the mix with grain, and the figure [n] in 0 to 1 at points [3, n] in cells."""

PATTERNS = tuple(_FIGURES)
"""Names of the patterns."""

SHARES = tuple(share for share, _ in _FIGURES.values())
"""Per pattern, the figure's share of the mix."""
