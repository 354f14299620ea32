"""The catalogue: every failure with its levels, the scene it happens in and what it does to the images."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace

from twin_node.bench.stability import perturbations as wrong
from twin_node.bench.stability.perturbations import Perturbation, untouched
from twin_node.bench.stability.scenes import (
    ONSET_S,
    blinking_box,
    circling,
    faint,
    one_box,
    screened_box,
    splitting_box,
    to_and_fro,
    turning_box,
)
from twin_node.cell import Scenario
from twin_node.cell.scenario import Fault

CALM = 0.6
"""Speed of the box in scenes in which something else goes wrong, m/s."""
BRISK = 1.0
"""Its speed where the images' times matter, m/s."""


@dataclass(frozen=True)
class Failure:
    """One way to fail."""

    title: str
    unit: str
    """Of the levels."""
    levels: tuple[float, ...]
    """Rising difficulty."""
    scene: Callable[[float, float], Scenario]
    """(level, seconds) -> what happens before the cameras."""
    perturb: Perturbation = untouched
    """What happens behind them."""
    seconds: Callable[[float, float], float] = lambda level, seconds: seconds
    """(level, usual seconds) -> length of the run."""


def calm(level: float, seconds: float) -> Scenario:
    """A box that circles at `CALM`."""
    return one_box(circling(CALM), seconds)


def _blurred(level: float, seconds: float) -> Scenario:
    scene = one_box(circling(BRISK), seconds)
    return replace(scene, sensing=replace(scene.sensing, exposure_ms=level))


def _late(level: float, seconds: float) -> Scenario:
    """The last camera looks `level` ms late."""
    scene = one_box(circling(BRISK), seconds)
    *others, last = scene.cameras
    return replace(scene, cameras=(*others, replace(last, skew_ms=last.skew_ms + level)))


def _hanging(level: float, seconds: float) -> Scenario:
    """From the onset on `level` cameras send their last image again and again, under new stamps."""
    scene = calm(level, seconds)
    hanging = scene.cameras[: int(level)]
    return replace(scene, faults=tuple(Fault("frozen", camera.name, ONSET_S) for camera in hanging))


def _bumped(level: float, seconds: float) -> Scenario:
    """At the onset the first camera is turned by `level` degrees."""
    scene = calm(level, seconds)
    return replace(scene, faults=(Fault("bumped", scene.cameras[0].name, ONSET_S, turn_deg=level),))


def _faint(level: float, seconds: float) -> Scenario:
    return one_box(circling(CALM), seconds, faint(level))


def _steady(level: float, seconds: float) -> Scenario:
    return one_box(circling(0.4), seconds)


def _noisy_depth(level: float, seconds: float) -> Scenario:
    scene = calm(level, seconds)
    return replace(scene, sensing=replace(scene.sensing, depth_sigma_at_1m_mm=level))


FAILURES: Mapping[str, Failure] = {
    "undisturbed": Failure("nothing wrong: a box turns", "m/s", (0.2, 0.5, 0.8), turning_box),
    "fast_motion": Failure("fast motion", "m/s", (0.1, 0.5, 1, 2, 4, 10), lambda v, s: one_box(circling(v), s)),
    "motion_blur": Failure("motion blur at 1 m/s", "ms", (5, 10, 20, 33), _blurred),
    "sudden_stop": Failure("sudden stop", "m/s", (0.5, 1, 2, 4), lambda v, s: one_box(circling(v, ONSET_S), s)),
    "reversal": Failure("reversal", "m/s", (0.25, 0.5, 1, 2), lambda v, s: one_box(to_and_fro(v, 0.35), s)),
    "appearance": Failure("appears and disappears", "per s", (0.5, 1, 2, 4), blinking_box),
    "split": Failure("comes apart", "m/s", (0.2, 0.5, 1, 2), splitting_box),
    "occlusion": Failure("screens before the cameras", "m", (0.1, 0.2, 0.3, 0.45), screened_box),
    "textureless": Failure(
        "no texture, contrast lost",
        "share",
        (0.5, 0.8, 0.9, 1),
        _faint,
    ),
    "reflective": Failure("mirror", "share", (0.25, 0.5, 0.75, 1), calm, wrong.reflective),
    "lights_switched": Failure(
        "light switched off and on", "share", (0.25, 0.5, 0.75, 0.9), calm, wrong.lights_switched
    ),
    "flicker": Failure("flicker", "share", (0.1, 0.2, 0.4, 0.8), calm, wrong.flicker),
    "exposure_hunting": Failure("exposure hunts", "stops", (0.25, 0.5, 1, 2), calm, wrong.exposure_hunting),
    "moving_shadow": Failure("moving shadow", "share", (0.2, 0.4, 0.6, 0.8), calm, wrong.moving_shadow),
    "rolling_shutter": Failure(
        "rolling shutter", "ms", (5, 10, 20, 33), lambda _, s: one_box(circling(BRISK), s), wrong.rolling_shutter
    ),
    "rolling_stamps": Failure(
        "stamps off at random", "ms", (2, 5, 10, 15), lambda _, s: one_box(circling(BRISK), s), wrong.stamp_jitter
    ),
    "dropped_frames": Failure("dropped images", "share", (0.2, 0.4, 0.6, 0.8), calm, wrong.dropped_frames),
    "desync": Failure("one camera's clock wrong", "ms", (10, 33, 66, 100), _late, wrong.wrong_clock),
    "calibration_error": Failure("one camera misplaced", "mm", (5, 10, 20, 50), calm, wrong.calibration_error),
    "depth_noise": Failure("depth noise at 1 m", "mm", (5, 10, 20, 40), _noisy_depth),
    "depth_holes": Failure("holes in the depth", "share", (0.25, 0.5, 0.75, 1), calm, wrong.depth_holes),
    "dead_camera": Failure("dead cameras", "of 3", (1, 2, 3), calm, wrong.dead_cameras),
    "hanging_camera": Failure("cameras that hang", "of 3", (1, 2, 3), _hanging),
    "bumped_camera": Failure("one camera turned by a knock", "deg", (0.25, 0.5, 1, 5), _bumped),
    "leaving_the_box": Failure(
        "leaves the workspace and returns", "m/s", (0.5, 1, 1.5, 2), lambda v, s: one_box(to_and_fro(v, 1.05), s)
    ),
    "image_noise": Failure("image noise", "levels", (5, 10, 20, 40), calm, wrong.image_noise),
    "noise_rises": Failure("image noise that rises at once", "levels", (5, 10, 20, 40), calm, wrong.noise_rises),
    "noise_only": Failure("noise in place of images", "share", (0.25, 0.5, 0.75, 1), calm, wrong.noise_only),
    "black_frames": Failure("black images in a row", "sets", (1, 3, 10, 30), calm, wrong.black_frames),
    "steady": Failure("steady motion", "s", (5, 10, 20, 40), _steady, seconds=lambda long, _: long),
    "hours": Failure("long runs", "bounces", (2, 4, 8), calm, untouched, lambda bounces, s: bounces * s),
}
"""By the names that `--json` prints."""
UNDISTURBED = ("undisturbed",)
"""Those in which nothing goes wrong: on them the status must say so."""
LONG = ("steady", "hours")
"""Those whose runs are longer than all others."""
