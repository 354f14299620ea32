"""What a bundle's images would rather have otherwise than it was solved: told by one step of the solver."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from twin_node.rig.calibrate.bundle import BundleOptions, BundleResult, Layout, Sighting
from twin_node.rig.calibrate.bundle_equations import BundleEquations, Change
from twin_node.rig.calibrate.bundle_problem import BundleProblem
from twin_node.rig.calibrate.rotations import apart, moved
from twin_node.scene import Bool, Float64

MOST_GAIN = 25.0
"""Nine numbers more gain 4.5 by chance, this once in ten million times; real boards and shutters make it up to 10."""

MOVED_M, MOVED_RAD = 0.003, 2e-3
"""What cameras are further off by matters: 3 mm, a tenth of a degree."""

SET_S = 0.005
"""A clock that is off by less is no matter."""

LIKE_PX = 1.0
"""A board that has moved by less in an image says nothing new: detectors err as they did before, and ten images of a
board at rest are one witness."""

DAMPING = 1e-4
"""What no image tells stays as it is."""


@dataclass(frozen=True)
class Step:
    """A step of the solver with more free than there was."""

    change: Change
    gain: float
    """Half the sum of squares, in sigmas, that it would be less by."""
    layout: Layout
    T_cam_rig: Float64
    """[C, 4, 4] of the cameras before it, optical frames."""

    def place(self, camera: int) -> Float64:
        """[4, 4] `T_cam_rig` of a camera after it."""
        change = self.change.outer[self.layout.camera(camera)]
        return moved(self.T_cam_rig[camera], change) if len(change) else self.T_cam_rig[camera]


@dataclass(frozen=True)
class OtherLens:
    """A camera's lens as its images would have it, where it was given as certain."""

    gain: float
    """Half the square of how far it is off the one given, in sigmas."""
    focal_px: float
    shift_m: float
    """How far the camera that this moves most would be moved."""
    turn_rad: float

    @property
    def matters(self) -> bool:
        """Whether it makes cameras stand elsewhere by more than rigs are wanted to be right to."""
        return self.shift_m > MOVED_M or self.turn_rad > MOVED_RAD


@dataclass(frozen=True)
class OtherClocks:
    """The cameras' clocks as their images would have them, where they were given as one."""

    gain: float
    """Half the sum of squares, in sigmas, that a step with clocks of their own would be less by."""
    later_s: Float64
    """[C] s to add to each camera's time; the first's is right."""

    @property
    def matter(self) -> bool:
        """Whether one of them is off by more than cameras that share a trigger are."""
        return bool((np.abs(self.later_s) > SET_S).any())


@dataclass(frozen=True)
class Witnesses:
    """The sightings of a bundle that say something new."""

    bundle: BundleResult
    sightings: tuple[Sighting, ...]
    delays: Float64
    """[V] s."""
    misfits: Float64
    """[V] root mean square, in sigmas, of what each is off."""

    @classmethod
    def of(cls, given: Sequence[Sighting], bundle: BundleResult) -> Witnesses:
        """`given`: what the bundle was made of."""
        lost, unlike = {id(sighting) for sighting in bundle.left_out}, _unlike(bundle)
        misfits = np.array(
            [
                np.sqrt((off**2).mean()) / bundle.noise_px[sighting.camera]
                for sighting, off in zip(bundle.sightings, bundle.residuals, strict=True)
            ]
        )
        sightings = tuple(sighting for sighting, new in zip(bundle.sightings, unlike, strict=True) if new)
        return cls(bundle, sightings, bundle.state.delays[[id(s) not in lost for s in given]][unlike], misfits[unlike])

    def without(self, view: int) -> Witnesses:
        """All but one of them."""
        sightings = (*self.sightings[:view], *self.sightings[view + 1 :])
        return Witnesses(self.bundle, sightings, np.delete(self.delays, view), np.delete(self.misfits, view))

    def divided(self, camera: int, late: Bool) -> Step:
        """`late` [V] of the sightings are those of one more camera, which is as `camera` is at first."""
        other = len(self.bundle.state.lenses)
        sightings = [replace(s, camera=other) if new else s for s, new in zip(self.sightings, late, strict=True)]
        return self._step([*range(other), camera], sightings)

    @cached_property
    def undivided(self) -> Step:
        """With nothing more free: solutions are near the best, not there."""
        return self._step([*range(len(self.bundle.state.lenses))], self.sightings)

    def other_lenses(self) -> list[OtherLens]:
        """Per camera: its lens, if lenses that are fixed were free."""
        everyone = [*range(len(self.bundle.state.lenses))]
        about = self._about(everyone, self.sightings, lenses=True)
        change, covariance = about.equations.solution(DAMPING).outer, about.equations.normal.outer_covariance()
        before = self.bundle.state.T_cam_rig[1:]
        after = moved(before, change[: 6 * len(before)].reshape(-1, 6))
        shift_m, turn_rad = (figure.max() for figure in apart(before, after))
        out = []
        for i, lens in enumerate(self.bundle.state.lenses):
            own = about.layout.lens(i)
            gain = 0.5 * float(change[own] @ np.linalg.solve(covariance[own, own], change[own]))
            out.append(OtherLens(gain, float(lens.K[0, 0] + change[own][0]), float(shift_m), float(turn_rad)))
        return out

    def other_clocks(self) -> OtherClocks:
        """As they would be if clocks that are fixed were free; of a board at rest, right."""
        everyone = range(len(self.bundle.state.lenses))
        step = self._step(everyone, self.sightings, clocks=True)
        later_s = [float(step.change.outer[step.layout.clock(i)][:1].sum()) for i in everyone]
        return OtherClocks(step.gain - self.undivided.gain, np.array(later_s))

    def _step(self, cameras: Sequence[int], sightings: Sequence[Sighting], clocks: bool = False) -> Step:
        about = self._about(cameras, sightings, clocks=clocks)
        change = about.equations.solution(DAMPING)
        return Step(change, about.equations.promise(change), about.layout, self.bundle.state.T_cam_rig[cameras])

    def _about(
        self, cameras: Sequence[int], sightings: Sequence[Sighting], lenses: bool = False, clocks: bool = False
    ) -> _About:
        """The equations about the bundle's state, of cameras that are as `cameras` of it are.

        `lenses`, `clocks`: which are free though they were fixed; lenses that were free are fixed.
        """
        bundle = self.bundle
        state = replace(
            bundle.state,
            T_cam_rig=bundle.state.T_cam_rig[cameras],
            lenses=tuple(bundle.state.lenses[i] for i in cameras),
            clocks=bundle.state.clocks[cameras],
            readouts=bundle.state.readouts[cameras],
            delays=self.delays,
        )
        free = BundleOptions(lenses=lenses, clocks=clocks or bundle.layout.clocks, delays=bundle.layout.clocks)
        problem = BundleProblem(state, sightings, free)
        problem.jitter, problem.hands = bundle.jitter_s[cameras], bundle.hands
        equations = problem.equations(problem.look(state), problem.seen, bundle.noise_px[cameras])
        return _About(problem.layout, equations)


@dataclass(frozen=True)
class _About:
    layout: Layout
    equations: BundleEquations


def _unlike(bundle: BundleResult) -> Bool:
    """[V] which sightings show the board elsewhere than the one before them of their camera that does."""
    before: dict[int, Float64] = {}
    unlike = np.zeros(len(bundle.sightings), dtype=bool)
    for view in np.argsort([sighting.time_s for sighting in bundle.sightings], kind="stable").tolist():
        sighting = bundle.sightings[view]
        pixels = np.full((len(bundle.state.points), 2), np.nan)
        pixels[sighting.corners.ids] = sighting.corners.pixels
        off = np.linalg.norm(pixels - before.get(sighting.camera, np.full_like(pixels, np.nan)), axis=1)
        unlike[view] = not np.isfinite(off).any() or np.nanmedian(off) > LIKE_PX
        if unlike[view]:
            before[sighting.camera] = pixels
    return unlike
