"""Whether cameras stood still, and their clocks ran on, while a board was recorded.

A camera that is moved half-way bends the whole fit, and delays of single images may take up most of what does not fit.
So each camera's later images are taken for those of another one, and what that would gain is told by one step.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from twin_node.rig.calibrate.bundle import BundleOptions, BundleResult, Sighting
from twin_node.rig.calibrate.bundle_problem import BundleProblem
from twin_node.rig.errors import RigError
from twin_node.scene import Float64

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
    """By how much half the sum of squares, in sigmas, would be less."""
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
    lost = {id(sighting) for sighting in bundle.left_out}
    kept = np.array([id(sighting) not in lost for sighting in given])
    times = np.array([sighting.time_s for sighting in bundle.sightings])
    own = np.array([sighting.camera == camera for sighting in bundle.sightings])
    late = own & (times > np.median(times[own]))
    other = len(bundle.state.lenses)
    sightings = [replace(s, camera=other) if new else s for s, new in zip(bundle.sightings, late, strict=True)]

    def doubled(values: Float64) -> Float64:
        return np.concatenate([values, values[[camera]]])

    state = replace(
        bundle.state,
        T_cam_rig=doubled(bundle.state.T_cam_rig),
        lenses=(*bundle.state.lenses, bundle.state.lenses[camera]),
        clocks=doubled(bundle.state.clocks),
        readouts=doubled(bundle.state.readouts),
        delays=bundle.state.delays[kept],
    )
    problem = BundleProblem(state, sightings, BundleOptions(lenses=False, clocks=bundle.layout.clocks))
    problem.jitter, problem.hands = doubled(bundle.jitter_s), bundle.hands
    equations = problem.equations(problem.look(state), problem.seen, doubled(bundle.noise_px))
    change, slopes = equations.solution(DAMPING), equations.normal.slopes
    gain = 0.5 * float(change.inner @ slopes[0] + change.outer @ slopes[1])
    layout = problem.layout
    moved, later = change.outer[layout.camera(other)], change.outer[layout.clock(other)][:1].sum()
    if camera > 0:
        moved = moved - change.outer[layout.camera(camera)]
        later -= change.outer[layout.clock(camera)][:1].sum()
    return Split(gain, float(np.linalg.norm(moved[3:])), float(np.linalg.norm(moved[:3])), float(later))
