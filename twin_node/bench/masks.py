"""`twin_node bench masks SCENARIO`: the moving masks alone, beside what truly moves in a simulated cell."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from twin_node.bench.mask_scores import MaskFigures, MaskTally, PixelKinds, compare, figures_of
from twin_node.bench.mask_truth import MovingParts
from twin_node.bench.text_table import markdown_table, percent
from twin_node.cell import CellSource, Scenario
from twin_node.model import MovingMask, SeedParameters
from twin_node.model.arm_mask import robot_masks
from twin_node.model.balance import balance
from twin_node.model.camera_mask import seen_by
from twin_node.model.exposure import Exposures, Levelled
from twin_node.model.seeding import find_plane, find_surfaces
from twin_node.nodes.log_source import DEFAULT_WIDTH
from twin_node.robot import ArmModel
from twin_node.scene import Bool, FrameSet, UInt8

SCENARIOS = ("conveyor", "reach_in", "cross", "demo")
"""What `all` stands for."""
MOMENTS = 5
"""Sets of the first seed that are kept to be drawn, evenly over the run."""


@dataclass(frozen=True)
class MasksBenchParameters:
    """How a scenario is rendered."""

    width: int = DEFAULT_WIDTH
    """Of the images, pixels."""
    max_rate_hz: float | None = None
    """Its cameras take no more sets per second; None: as many as the scenario says."""


@dataclass(frozen=True)
class Shot:
    """One image with what its mask made of it."""

    camera: str
    stamp: int
    """ns."""
    rgb: UInt8
    """[H, W, 3]."""
    kinds: PixelKinds


@dataclass(frozen=True)
class MasksRun:
    """One seed."""

    seed: int
    tallies: Mapping[str, MaskTally]
    """By camera."""
    moments: Sequence[Sequence[Shot]]
    """Some of the sets, of the first seed alone."""


@dataclass(frozen=True)
class MasksBench:
    """One scenario over all seeds."""

    scenario: Scenario
    """As it was rendered."""
    runs: Sequence[MasksRun]
    """One per seed."""

    def as_json(self) -> dict[str, object]:
        """The stable names that `--json` prints."""
        cameras = [camera.name for camera in self.scenario.cameras]
        sensing = self.scenario.sensing
        return {
            "scenario": self.scenario.name,
            "seeds": len(self.runs),
            "width": sensing.width,
            "height": sensing.height,
            "rate_hz": sensing.rate_hz,
            **asdict(self.figures),
            "cameras": {name: asdict(figures_of(run.tallies[name] for run in self.runs)) for name in cameras},
        }

    @property
    def figures(self) -> MaskFigures:
        """Over all cameras."""
        return figures_of(tally for run in self.runs for tally in run.tallies.values())

    @property
    def row(self) -> tuple[str, ...]:
        """Its line of the table, in the order of `HEADINGS`."""
        found = self.figures
        return (
            self.scenario.name,
            *(_pixels(pixels) for pixels in (found.moving_px, found.missed_px)),
            percent(found.missed_share),
            *(_pixels(pixels) for pixels in (found.missed_rested_px, found.missed_waiting_px, found.false_px)),
            *(percent(share) for share in (found.false_share, found.false_lasting_share)),
        )


HEADINGS = (
    *("scenario", "moving, px per image", "missed", "of moving", "missed, come to rest", "missed, yet to move"),
    *("false", "of moving", "of false, over 0.5 s"),
)


def table(benches: Iterable[MasksBench]) -> str:
    """A Markdown table, one scenario per line."""
    return markdown_table(HEADINGS, (bench.row for bench in benches))


def run(
    scenario: Scenario,
    seeds: range,
    parameters: MasksBenchParameters | None = None,
    progress: Callable[[Iterable[FrameSet], int], Iterable[FrameSet]] = lambda sets, total: sets,
) -> MasksBench:
    """Simulates a scenario per seed and scores the masks of every image; `progress` may wrap the sets of a seed.

    Raises `CellError` where the scenario cannot be rendered so, and `RobotError` for an arm that is not known.
    """
    rendered = _as_asked(scenario, parameters or MasksBenchParameters())
    runs = [_run_seed(rendered.with_seed(seed), seed == seeds[0], progress) for seed in seeds]
    return MasksBench(rendered, runs)


class ModelMasks:
    """The moving masks as a window model has them, without the rest of it: nothing of that changes them."""

    def __init__(self, arm: ArmModel | None = None) -> None:
        self._arm = arm
        self._mask, self._exposures = MovingMask(arm), Exposures()
        self._has_begun = False

    def update(self, frames: FrameSet) -> list[tuple[Bool, Bool]]:
        """Per view the mask [H, W], and the pixels [H, W] that it was looked for in."""
        robots = robot_masks(self._arm, frames)
        even = self._level(frames, robots).frames
        masks = self._mask.update(even, robots)
        self._exposures.heed(even, masks)
        return [(mask, seen_by(view, robot)) for mask, view, robot in zip(masks, even.views, robots, strict=True)]

    def _level(self, frames: FrameSet, robots: Sequence[Bool | None]) -> Levelled:
        if self._has_begun:
            return self._exposures.level(frames, robots)
        self._has_begun = True
        surfaces = find_surfaces(frames.views, find_plane(frames.views), SeedParameters())
        return self._exposures.begin(frames, balance(frames.views, surfaces))


def _as_asked(scenario: Scenario, parameters: MasksBenchParameters) -> Scenario:
    scaled = scenario.at_width(parameters.width)
    rate_hz = min(scaled.sensing.rate_hz, parameters.max_rate_hz or np.inf)
    return replace(scaled, sensing=replace(scaled.sensing, rate_hz=rate_hz))


def _run_seed(
    scenario: Scenario, with_shots: bool, progress: Callable[[Iterable[FrameSet], int], Iterable[FrameSet]]
) -> MasksRun:
    source = CellSource(scenario)
    simulated, sensing = source.simulated, scenario.sensing
    parts = MovingParts(simulated)
    arm = simulated.world.arm
    masks = ModelMasks(None if arm is None else arm.model)
    tallies = {camera.name: MaskTally(sensing.height, sensing.width) for camera in source.cameras}
    drawn = np.linspace(0, simulated.ticks - 1, MOMENTS + 2).astype(int)[1:-1] if with_shots else ()
    moments = []
    for frames in progress(source, simulated.ticks):
        parts.advance(frames.stamp)
        shots = []
        for view, (mask, seen) in zip(frames.views, masks.update(frames), strict=True):
            kinds = compare(mask, parts.shown(view), seen)
            tallies[view.camera.name].add(view.stamp, kinds)
            shots.append(Shot(view.camera.name, view.stamp, view.rgb, kinds))
        if frames.sequence in drawn:
            moments.append(shots)
    return MasksRun(scenario.seed, tallies, moments)


def _pixels(pixels: float | None) -> str:
    return "" if pixels is None else f"{pixels:.0f}"
