"""Which voxels the cameras free, which hold what moves, and which nobody sees: the carving rules."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin_node.forecast.backdrops import Backdrops
from twin_node.forecast.errors import ForecastError
from twin_node.forecast.filled import FilledDepth
from twin_node.forecast.looking_past import LookingPast
from twin_node.forecast.sights import CarvingParameters, Look, dilated, sights_of
from twin_node.forecast.tables import Blocks, CameraTable, RigTables
from twin_node.forecast.unprojection import unproject
from twin_node.forecast.verdicts import BESIDE, Carved, Sight, carved
from twin_node.scene import Bool, Camera, Float32, TwinState, View

_PIXEL_ERROR = 0.5
"""A mask is no sharper than its pixels."""
_MOST_SIGMA_M = 1.0
"""As in rig files: whoever errs by more shows nothing."""


@dataclass(frozen=True)
class Opaque:
    """What stands, and cameras that measure no depth do not see past."""

    indices: NDArray[np.int64]
    """[n] flat voxel indices."""
    error_m: float = 0.0
    """How far behind these it may truly lie, m."""


class Carver:
    """Carves one grid with the views of a rig; what depends on the calibration alone is computed once per camera."""

    def __init__(self, tables: RigTables, parameters: CarvingParameters | None = None) -> None:
        self.parameters = parameters or CarvingParameters()
        self._tables = tables
        self._blocks = tables.blocks
        self._backdrops = Backdrops()
        self._filled = FilledDepth()
        self._past = LookingPast(tables.blocks.grid)
        self._fronts = _Fronts(self._blocks)
        self._last: tuple[TwinState, list[Sight]] | None = None

    def carve(self, state: TwinState, speed: float, opaque: Opaque | None = None) -> Carved:
        """Moving and unknown voxels of a state; `speed` (m/s) is how fast things may move between unequal stamps.

        `opaque`: None: as for the state before. States come in rising order of stamps: what each depth camera saw
        behind moving things before is remembered. A view that may be off by more than half of its image shows nothing.
        Raises `ForecastError` for images or masks that are not of their camera's size, and for a camera whose
        calibration error cannot be.
        """
        for view, moving, robot in zip(state.frames.views, state.moving_masks, state.robot_masks, strict=True):
            if misfit := view.misfit(moving=moving, robot=robot):
                raise ForecastError(f"state of {state.stamp} ns: {misfit}")
        self._filled.update(state, self._backdrops)
        self._backdrops.update(state)
        if opaque is not None:
            self._fronts.update(opaque)
        sights = self._sights(state, speed)
        self._last = (state, sights)
        return carved(self._blocks, sights)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What a reader must know of the cameras as of the last state."""
        return self._past.warnings

    def calmed(self, view: View) -> Float32:
        """[H, W] depth that a view of the last state measures, without its noise where that has been averaged, m."""
        return self._backdrops.calmed(view)

    def frees(self, state: TwinState, indices: NDArray[np.int64], through: Mapping[str, Bool] | None = None) -> Bool:
        """Whether some camera frees each of the voxels `indices` [n]; `through`: by these of its pixels [H, W] alone, a
        camera without any by none."""
        places = self._blocks.locate(indices)
        freed = np.zeros(len(indices), np.bool_)
        sights = self._last[1] if self._last is not None and self._last[0] is state else self._sights(state, 0.0)
        for sight in sights:
            seen = sight.table.at(places)
            frees = seen.depth < sight.free_until[seen.pixels]
            if through is not None:
                mask = through.get(sight.table.camera.name)
                frees &= np.append(mask, False)[seen.pixels] if mask is not None else False
            freed |= frees
        return freed

    def _sights(self, state: TwinState, speed: float) -> list[Sight]:
        looks = []
        for view, moving, robot in zip(state.frames.views, state.moving_masks, state.robot_masks, strict=True):
            table = self._tables.of(view.camera)
            error = self._calibration_error(view.camera)
            error += _moved_since(state, view, speed) + self._blocks.grid.voxel_size / 2
            pixels = error * table.pixels_per_metre + _PIXEL_ERROR
            backdrop = None if view.depth is None else self._backdrops.of(view)
            look = Look(table, view, moving, robot, backdrop, pixels)
            # Beyond that what it shows may be anywhere by now, and takes minutes to widen.
            looks.append(look if pixels <= max(moving.shape) / 2 else _showing_nothing(look))
        looks = self._filled.without(looks)
        sights = sights_of(looks, self.parameters)
        for look, sight in zip(looks, sights, strict=True):
            _end_sooner(look, sight, _moved_since(state, look.view, speed))
        for sight, doubted in zip(sights, self._past.of(looks, state.stamp), strict=True):
            if doubted is not None:
                sight.free_until[:-1][doubted.ravel()] = 0
                sight.flags[:-1][doubted.ravel()] &= ~BESIDE
        flat = [(look, sight) for look, sight in zip(looks, sights, strict=True) if look.view.depth is None]
        measured = self._measured_to_move(looks, sights) if flat else np.zeros(0, np.int64)
        for look, sight in flat:
            self._end_before(measured, look, sight)
        return sights

    def _measured_to_move(self, looks: Sequence[Look], sights: Sequence[Sight]) -> NDArray[np.int64]:
        """Flat indices [n] of the voxels in which views with depth measure what moves."""
        points = [np.zeros((0, 3), np.float32)]
        for look, sight in zip(looks, sights, strict=True):
            if sight.surface is not None and look.view.depth is not None:
                depth = look.view.depth.ravel()
                within = (sight.surface.begin[:-1] <= depth) & (depth < sight.surface.end[:-1])
                points.append(unproject(look.view, look.moving & within.reshape(look.moving.shape)))
        found = self._blocks.grid.indices(np.concatenate(points))
        return np.unique(found[found >= 0])

    def _end_before(self, moving: NDArray[np.int64], look: Look, sight: Sight) -> None:
        """Lets a view without depth free nothing behind what is known to stand, nor behind what is measured to move.

        It does not measure how far it sees, and may take who keeps still for ground. One whose depth image is missing
        frees nothing where it has never measured any either, as with that image. `moving` [n]: flat indices.
        """
        known = np.minimum(self._fronts.of(look.table), self._backdrops.of(look.view))
        if len(moving):
            known = np.minimum(known, look.table.fronts_of(self._blocks.locate(moving)))
        known = known.ravel()
        fronts = known * np.float32(1 - self.parameters.depth_share) - np.float32(self.parameters.depth_margin)
        freed = sight.free_until[:-1]
        np.minimum(freed, np.where(known > 0, fronts, freed), out=freed)
        unmeasured = self._backdrops.unmeasured(look.view)
        if unmeasured is not None:
            freed[dilated(unmeasured, look.error_pixels).ravel()] = 0

    def _calibration_error(self, camera: Camera) -> float:
        """By how far a camera's calibration lets masks and surfaces be off, m.

        Raises `ForecastError` for what no camera errs by: a kernel that widens by what is no number comes to no end.
        """
        if not 0 <= camera.sigma_m <= _MOST_SIGMA_M:
            raise ForecastError(
                f"camera {camera.name}: expected a calibration error (sigma_m) of 0 to {_MOST_SIGMA_M:g} m, found "
                f"{camera.sigma_m:g}; correct the rig"
            )
        return self.parameters.sigmas * (camera.sigma_m or self.parameters.assumed_sigma_m)


def _moved_since(state: TwinState, view: View, speed: float) -> float:
    """How far what moves at a speed (m/s) may be from where a view shows it, m: views have stamps of their own."""
    return abs(state.stamp - view.stamp) * 1e-9 * speed


def _end_sooner(look: Look, sight: Sight, nearer_m: float) -> None:
    """Lets a view free so much less (m) where it shows something that moves: it may have come nearer since."""
    if nearer_m > 0:
        sight.free_until[:-1][dilated(look.moving, look.error_pixels).ravel()] -= np.float32(nearer_m)


def _showing_nothing(look: Look) -> Look:
    """A look none of whose pixels counts."""
    return replace(look, view=replace(look.view, valid=np.zeros_like(look.moving)), error_pixels=_PIXEL_ERROR)


class _Fronts:
    """How deep cameras without depth see before they meet what stands; drawn once per camera as long as that stands."""

    def __init__(self, blocks: Blocks) -> None:
        self._blocks = blocks
        self._opaque = Opaque(np.zeros(0, np.int64))
        self._drawn: dict[str, tuple[CameraTable, Float32]] = {}

    def update(self, opaque: Opaque) -> None:
        """Takes in what stands now."""
        if opaque is not self._opaque:
            self._opaque, self._drawn = opaque, {}

    def of(self, table: CameraTable) -> Float32:
        """[H, W] m, of a camera."""
        known = self._drawn.get(table.camera.name)
        if known is None or known[0] is not table:
            opaque, places = self._opaque, self._blocks.locate(self._opaque.indices)
            fronts = table.fronts_of(places, are_measured=opaque.error_m == 0) + np.float32(opaque.error_m)
            known = self._drawn[table.camera.name] = (table, fronts)
        return known[1]
