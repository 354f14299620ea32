"""The simulated rig: a scenario's images in rising order of time, one by one or as synchronised sets."""

from __future__ import annotations

from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from twin_node.cell.raycast import RayCaster
from twin_node.cell.rendering import Rendering
from twin_node.cell.rig import make_rig, pinhole
from twin_node.cell.scenario import UNSORTED_STEP_NS, Fault, Scenario
from twin_node.cell.sensor import DrawnNoise, RawImage, sense
from twin_node.cell.world import World
from twin_node.geometry import pose
from twin_node.scene import Camera, FrameSet, Rig, UInt8, View

_STAMPS, _NOISE, _ARRIVALS = 2, 3, 4
"""Distinguish these uses of the scenario's seed from each other and from the world's."""

SHUTTER_SHARES = (-0.4, -0.2, 0.2, 0.4)
"""Times beside the middle at which an open shutter is sampled, as shares of the exposure."""


@dataclass(frozen=True)
class Exposure:
    """One image to be taken."""

    camera: int
    """Index in the rig."""
    tick: int
    """Number of the set that it belongs to."""
    stamp: int
    """Its true time, the middle of the exposure, ns."""
    arrival: int
    """When its image has arrived, ns; never before an earlier image of the same camera."""


class SimulatedRig:
    """A scenario's cameras: when they look and what they see. The same scenario gives the same bytes."""

    def __init__(self, scenario: Scenario, draws_noise_once: bool = False) -> None:
        """`draws_noise_once`: images take half of the processor time, and have other bytes; see `DrawnNoise`."""
        self.scenario = scenario
        self.world = World(scenario)
        self.rig: Rig = make_rig(scenario)
        self.cameras: tuple[Camera, ...] = tuple(pinhole(camera) for camera in self.rig.cameras)
        self.renderers = tuple(RayCaster(camera, self.world.static) for camera in self.cameras)
        self._stamps = self._draw_stamps()
        self._arrivals = self._draw_arrivals()
        pixels = max(camera.width * camera.height for camera in self.cameras)
        self._noise = DrawnNoise(pixels, scenario.seed) if draws_noise_once else None
        self._bumped: dict[Fault, RayCaster] = {}
        self._newest: dict[int, tuple[int, Rendering]] = {}
        """Per camera, what was asked for last, and when it was seen, ns."""

    @property
    def ticks(self) -> int:
        """Number of image sets; 2.3 s at 30 Hz are 69, though their product is a little less."""
        return int(np.floor(self.scenario.duration_s * self.scenario.sensing.rate_hz + 1e-6))

    def exposures(self) -> list[Exposure]:
        """All images that the cameras take, in rising order of true time; those of missing cameras left out."""
        taken = [self._exposure(camera, tick) for tick in range(self.ticks) for camera in range(len(self.cameras))]
        seen = [e for e in taken if self._fault(e, "missing") is None]
        return sorted(seen, key=lambda e: (e.stamp, e.camera))

    def arrivals(self) -> list[Exposure]:
        """The same in the order in which their images arrive."""
        return sorted(self.exposures(), key=lambda e: (e.arrival, e.camera))

    def tick_stamps(self) -> list[int]:
        """Per set, the true time of its last exposure, ns, whether or not the cameras are faulty."""
        return [int(stamp) for stamp in self._stamps.max(axis=1)]

    def see(self, camera: int, stamp: int) -> Rendering:
        """The noiseless image of a camera of the rig, where it was calibrated, at any time; to be read only.

        Rendered once where it is asked for twice in a row, as the sensor's and as truth.
        """
        newest = self._newest.get(camera)
        if newest is None or newest[0] != stamp:
            newest = self._newest[camera] = (stamp, self._shown(self.renderers[camera], stamp))
        return newest[1]

    def take(self, exposure: Exposure) -> RawImage:
        """The image as the camera sends it, with its noise and its faults."""
        frozen = self._fault(exposure, "frozen")
        source = exposure if frozen is None else self._first_in(frozen, exposure)
        rng = np.random.default_rng([self.scenario.seed, _NOISE, source.camera, source.tick])
        noise = rng if self._noise is None else self._noise.part_of(rng)
        stamp = exposure.stamp
        if self._fault(exposure, "unsorted_stamps") is not None and exposure.tick % 2:
            stamp -= UNSORTED_STEP_NS
        image = sense(self.cameras[exposure.camera].name, stamp, self._seen(source), self.scenario.sensing, noise)
        return replace(image, depth_is_nan=self._fault(exposure, "nan_depth") is not None)

    def _seen(self, exposure: Exposure) -> Rendering:
        """What the sensor, which may have been bumped, collects while the shutter is open, as bright as it is set."""
        fault = self._fault(exposure, "bumped")
        renderer = self.renderers[exposure.camera] if fault is None else self._renderer_of(fault)
        sharp = self.see(exposure.camera, exposure.stamp) if fault is None else self._shown(renderer, exposure.stamp)
        gain = self.scenario.cameras[exposure.camera].gain
        open_ns = self.scenario.sensing.exposure_ms * 1e6
        if open_ns == 0 and gain == 1:
            return sharp
        offsets = [round(open_ns * share) for share in SHUTTER_SHARES if open_ns > 0]
        frames = [self._shown(renderer, exposure.stamp + offset).rgb for offset in offsets]
        mean = np.stack([sharp.rgb, *frames]).mean(axis=0, dtype=np.float32)
        rgb: UInt8 = np.clip(gain * mean + 0.5, 0, 255).astype(np.uint8)
        return replace(sharp, rgb=rgb)

    def _renderer_of(self, fault: Fault) -> RayCaster:
        """That of a bumped camera, made once."""
        if fault not in self._bumped:
            from scipy.spatial.transform import Rotation  # loads slowly, and who only reads a scenario never asks

            camera = next(camera for camera in self.cameras if camera.name == fault.camera)
            turn = pose(Rotation.from_euler("y", fault.turn_deg, degrees=True).as_matrix(), np.zeros(3))
            self._bumped[fault] = RayCaster(replace(camera, T_base_cam=camera.T_base_cam @ turn), self.world.static)
        return self._bumped[fault]

    def _shown(self, renderer: RayCaster, stamp: int) -> Rendering:
        return renderer.render((*self.world.moving(stamp), *self.world.arm_solids(stamp)))

    def _first_in(self, fault: Fault, exposure: Exposure) -> Exposure:
        seconds = (self._stamps[:, exposure.camera] - self.scenario.start_ns) / 1e9
        tick = int(np.argmax(seconds >= fault.from_s))
        return self._exposure(exposure.camera, tick)

    def _exposure(self, camera: int, tick: int) -> Exposure:
        return Exposure(camera, tick, int(self._stamps[tick, camera]), int(self._arrivals[tick, camera]))

    def _fault(self, exposure: Exposure, kind: str) -> Fault | None:
        t = self.world.seconds(exposure.stamp)
        name = self.cameras[exposure.camera].name
        for fault in self.scenario.faults:
            if fault.kind == kind and fault.camera == name and fault.from_s <= t < fault.to_s:
                return fault
        return None

    def _draw_stamps(self) -> NDArray[np.int64]:
        """[ticks, cameras] true times of all exposures, ns."""
        sensing = self.scenario.sensing
        rng = np.random.default_rng([self.scenario.seed, _STAMPS])
        jitter_ms = np.clip(rng.normal(size=(self.ticks, len(self.cameras))), -3, 3) * sensing.jitter_ms
        skews_ms = np.array([camera.skew_ms for camera in self.scenario.cameras])
        ticks_ms = (np.arange(self.ticks) + 0.5)[:, None] * 1000 / sensing.rate_hz
        late_ms = ticks_ms + skews_ms + jitter_ms
        stamps: NDArray[np.int64] = np.rint(late_ms * 1e6).astype(np.int64) + self.scenario.start_ns
        return stamps

    def _draw_arrivals(self) -> NDArray[np.int64]:
        """[ticks, cameras] when the images have arrived, ns."""
        sensing = self.scenario.sensing
        rng = np.random.default_rng([self.scenario.seed, _ARRIVALS])
        late = np.clip(np.abs(rng.normal(size=self._stamps.shape)), 0, 3) * sensing.latency_jitter_ms
        closing_ms = sensing.exposure_ms / 2
        arrivals = self._stamps + np.rint((closing_ms + sensing.latency_ms + late) * 1e6).astype(np.int64)
        return np.asarray(np.maximum.accumulate(arrivals, axis=0))


class CellSource:
    """The simulated rig as a source of synchronised sets; see `scene.FrameSource`."""

    def __init__(self, scenario: Scenario, threads: int = 1, stride: int = 1) -> None:
        """`threads`: cameras that are rendered at once; the images are the same for any number.

        `stride`: every so many ticks give a set, the same as without.
        """
        self.simulated = SimulatedRig(scenario)
        self._threads = threads
        self._stride = stride

    @property
    def rig(self) -> Rig:
        """The calibrated cameras and the workspace."""
        return self.simulated.rig

    @property
    def cameras(self) -> tuple[Camera, ...]:
        """All cameras of the rig, in the order of every set's views."""
        return self.simulated.cameras

    def __iter__(self) -> Iterator[FrameSet]:
        """One set per tick of the rig that is wanted; a tick that no camera answers gives none."""
        by_tick: dict[int, list[Exposure]] = {}
        for exposure in self.simulated.exposures():
            if exposure.tick % self._stride == 0:
                by_tick.setdefault(exposure.tick, []).append(exposure)
        arm = self.simulated.world.arm
        with ThreadPoolExecutor(self._threads) as pool:
            for tick in sorted(by_tick):
                views = tuple(pool.map(self._view, sorted(by_tick[tick], key=lambda e: e.camera)))
                stamp = max(view.stamp for view in views)
                yield FrameSet(stamp, views, None if arm is None else arm.sample(stamp), tick)

    def _view(self, exposure: Exposure) -> View:
        image = self.simulated.take(exposure)
        return View(self.cameras[exposure.camera], image.stamp, image.rgb, image.depth_m)
