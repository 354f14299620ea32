"""Whether cameras stood still, and their clocks ran on, while a board was recorded.

A camera that is moved half-way bends the whole fit, and delays of single images may take up most of what does not fit.
So each camera's later images are taken for those of another one, and what that would gain is told by one step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_node.rig.calibrate.bundle import BundleOptions, BundleResult, Layout, Sighting
from twin_node.rig.calibrate.bundle_equations import Change
from twin_node.rig.calibrate.bundle_problem import BundleProblem
from twin_node.rig.errors import RigError
from twin_node.scene import Bool

MOST_GAIN = 25.0
"""Nine numbers more gain 4.5 by chance, this once in ten million times; real boards and shutters make it up to 10."""

MOVED_M, MOVED_RAD, SET_S = 0.003, 2e-3, 0.005
"""What is less is no matter: 3 mm, a tenth of a degree, 5 ms."""

DAMPING = 1e-4
"""What no image tells of the other camera stays as it is."""


@dataclass(frozen=True)
class Split:
    """A camera's later images, as if another one had taken them."""

    gain: float
    """By how much half the sum of squares, in sigmas, would be less than it is, or can be with one camera."""
    shift_m: float
    """Between where the two would stand."""
    turn_rad: float
    later_s: float
    """By how much the other one's clock would be off."""

    @property
    def matters(self) -> bool:
        """Whether the two differ by more than what rigs are wanted to be right to."""
        return self.shift_m > MOVED_M or self.turn_rad > MOVED_RAD or abs(self.later_s) > SET_S


def check_steady(names: Sequence[str], given: Sequence[Sighting], bundle: BundleResult) -> None:
    """Raises `RigError` where a camera's later images are another camera's; `given`: what the bundle was made of."""
    told = [(name, split(given, bundle, camera)) for camera, name in enumerate(names)]
    name, worst = max(told, key=lambda pair: pair[1].gain)
    if worst.gain > MOST_GAIN and worst.matters:
        raise RigError(
            f"camera {name}: expected one place and one clock all along, found the later half of its images "
            f"{1e3 * worst.shift_m:.0f} mm, {np.degrees(worst.turn_rad):.1f} degrees and "
            f"{1e3 * abs(worst.later_s):.0f} ms off the earlier ones'; "
            "was it moved, focused or its clock set meanwhile? "
            "Record it again, or leave out what lies before or after"
        )


def split(given: Sequence[Sighting], bundle: BundleResult, camera: int) -> Split:
    """What the later half of one camera's images would gain; `given`: the sightings that the bundle was made of."""
    times = np.array([sighting.time_s for sighting in bundle.sightings])
    own = np.array([sighting.camera == camera for sighting in bundle.sightings])
    other = len(bundle.state.lenses)
    late = own & (times > np.median(times[own]))
    if not late.any():
        return Split(0.0, 0.0, 0.0, 0.0)
    one, two = _step(given, bundle, camera, np.zeros_like(late)), _step(given, bundle, camera, late)
    moved, later = two.change.outer[two.layout.camera(other)], two.change.outer[two.layout.clock(other)][:1].sum()
    if camera > 0:
        moved = moved - two.change.outer[two.layout.camera(camera)]
        later -= two.change.outer[two.layout.clock(camera)][:1].sum()
    shift_m, turn_rad = (float(np.linalg.norm(part)) for part in (moved[3:], moved[:3]))
    return Split(two.gain - one.gain, shift_m, turn_rad, float(later))


@dataclass(frozen=True)
class _Step:
    """A step of the solver beside which another camera took some of the images."""

    change: Change
    gain: float
    """Half the sum of squares, in sigmas, that it would be less by."""
    layout: Layout


def _step(given: Sequence[Sighting], bundle: BundleResult, camera: int, late: Bool) -> _Step:
    """`late` [V] of the bundle's sightings are those of the other camera, as `camera` is at first; none: no other."""
    lost = {id(sighting) for sighting in bundle.left_out}
    kept = np.array([id(sighting) not in lost for sighting in given])
    other = len(bundle.state.lenses)
    cameras = [*range(other), camera] if late.any() else [*range(other)]
    sightings = [replace(s, camera=other) if new else s for s, new in zip(bundle.sightings, late, strict=True)]
    state = replace(
        bundle.state,
        T_cam_rig=bundle.state.T_cam_rig[cameras],
        lenses=tuple(bundle.state.lenses[i] for i in cameras),
        clocks=bundle.state.clocks[cameras],
        readouts=bundle.state.readouts[cameras],
        delays=bundle.state.delays[kept],
    )
    problem = BundleProblem(state, sightings, BundleOptions(lenses=False, clocks=bundle.layout.clocks))
    problem.jitter, problem.hands = bundle.jitter_s[cameras], bundle.hands
    equations = problem.equations(problem.look(state), problem.seen, bundle.noise_px[cameras])
    change, (inner, outer) = equations.solution(DAMPING), equations.normal.slopes
    return _Step(change, 0.5 * float(change.inner @ inner + change.outer @ outer), problem.layout)
