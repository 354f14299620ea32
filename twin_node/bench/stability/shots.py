"""What the cameras of a stability test deliver, beside what a perfect camera would have seen."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

from twin_node.cell import CellSource, Scenario
from twin_node.cell.rendering import Rendering
from twin_node.cell.simulator import SimulatedRig
from twin_node.scene import FrameSet, UInt8


@dataclass(frozen=True)
class Shot:
    """One set of images before anything goes wrong with it."""

    frames: FrameSet
    seconds: float
    """After the start of the run."""
    exact: Mapping[str, Rendering]
    """Noiseless image per camera, at the time of its view."""
    rig: SimulatedRig

    def seen_at(self, camera: str, stamp: int) -> UInt8:
        """[H, W, 3] noiseless colours that a camera would see at another time, ns."""
        index = next(i for i, one in enumerate(self.rig.cameras) if one.name == camera)
        return self.rig.see(index, stamp).rgb


class Stage:
    """A scenario's shots in rising order of time, one of every `stride` sets of the rig."""

    def __init__(self, scenario: Scenario, stride: int = 1) -> None:
        self.source = CellSource(scenario, stride=stride)

    def __iter__(self) -> Iterator[Shot]:
        rig = self.source.simulated
        names = [camera.name for camera in rig.cameras]
        for frames in self.source:
            exact = {view.camera.name: rig.see(names.index(view.camera.name), view.stamp) for view in frames.views}
            yield Shot(frames, rig.world.seconds(frames.stamp), exact, rig)
