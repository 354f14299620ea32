"""`twin_node bench forecast --speed`: how long a forecast and its cover take, on a made-up scene."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import cache, partial

import numpy as np

from twin_node.forecast import Forecaster, cover
from twin_node.forecast.evidence import Observer
from twin_node.forecast.grid import encode_runs
from twin_node.forecast.sights import CarvingParameters
from twin_node.forecast.static import StaticParameters
from twin_node.geometry import looking_at
from twin_node.model.rays import pixel_rays
from twin_node.runtime.image_threads import image_loops_alone
from twin_node.scene import (
    HORIZONS_NS,
    Bool,
    Camera,
    Float32,
    Float64,
    FrameSet,
    GaussianCloud,
    Grid,
    NodeStates,
    Occupancy,
    OccupancyLayer,
    Tier,
    TwinState,
    View,
)

GRID = Grid(np.array([-1.0, -1.0, 0.0]), 0.02, (100, 100, 75))
WIDTH, HEIGHT = 160, 120
GAUSSIANS = 10_000
COVERED_VOXELS = 5_000
BALL_RADIUS = 0.15
"""Of the thing that moves, m: an arm's worth of voxels."""
PERIOD_NS = 33_333_333
SETS = 24
"""Image sets forecast; those of the first half are not timed."""
REPEATS = 20


@dataclass(frozen=True)
class ForecastSpeed:
    """The least of several times each, ms: what the work takes where nothing else wants the processor."""

    forecast_ms: float
    """From three RGB-D views and 10,000 Gaussians to the occupancy of 100 x 100 x 75 voxels in 5 layers."""
    evidence_ms: float
    """The part of it before anything is forecast: carving, velocities, static and unknown space."""
    cover_ms: float
    """Obstacles about 5,000 occupied voxels, over all layers."""

    def as_json(self) -> dict[str, object]:
        """The stable names that `--json` prints."""
        return dict(vars(self))


def run() -> ForecastSpeed:
    """Times one thread's work; best of several, because others' load only ever adds."""
    image_loops_alone()
    forecaster, observer = Forecaster(GRID), Observer(GRID, CarvingParameters(), StaticParameters())
    whole, evidence = [], []
    for number in range(SETS):
        state = _state(number)
        whole.append(_timed_ms(partial(forecaster.update, state, state.stamp)))
        evidence.append(_timed_ms(partial(_evidence, observer, state)))
    occupancy = _ball_occupancy()
    covers = [_timed_ms(partial(cover, occupancy)) for _ in range(REPEATS)]
    settled = slice(SETS // 2, None)
    return ForecastSpeed(min(whole[settled]), min(evidence[settled]), min(covers))


def _evidence(observer: Observer, state: TwinState) -> None:
    observer.observe(state).unseen.result()


def _timed_ms(work: Callable[[], object]) -> float:
    begin = time.perf_counter()
    work()
    return 1e3 * (time.perf_counter() - begin)


@cache
def _cameras() -> tuple[Camera, ...]:
    """Three cameras 2 m around the middle of the grid; all sets share them, as those of a rig do."""
    middle = GRID.origin + np.array(GRID.dims) * GRID.voxel_size / 2
    K = np.array([[140.0, 0, WIDTH / 2], [0, 140.0, HEIGHT / 2], [0, 0, 1]])
    cameras = []
    for number, angle in enumerate(np.deg2rad([0, 120, 240])):
        eye = middle + np.array([2 * np.cos(angle), 2 * np.sin(angle), 0.8])
        cameras.append(Camera(f"cam{number}", WIDTH, HEIGHT, K, looking_at(eye, middle), 0.002))
    return tuple(cameras)


def _state(number: int) -> TwinState:
    """A ball that crosses the grid at 0.6 m/s above a floor, seen by three RGB-D cameras."""
    stamp = number * PERIOD_NS
    center = np.array([-0.3 + 0.6 * stamp * 1e-9, 0.0, 0.6])
    views, masks = [], []
    for camera in _cameras():
        depth, mask = _seen(camera, center)
        pattern = (np.indices((HEIGHT, WIDTH)).sum(axis=0) * 37 + 11 * number * mask) % 200
        views.append(View(camera, stamp, np.repeat(pattern[..., None], 3, axis=2).astype(np.uint8), depth))
        masks.append(mask)
    frames, robots = FrameSet(stamp, tuple(views)), (None,) * len(views)
    return TwinState(stamp, frames, _floor(), NodeStates.none(), tuple(masks), robots)


def _seen(camera: Camera, center: Float64) -> tuple[Float32, Bool]:
    """Depth [H, W] in metres of the ball before the floor, and where the ball shows."""
    rays = pixel_rays(camera)
    offset = camera.T_base_cam[:3, 3] - center
    a, b = (rays**2).sum(axis=-1), (rays * offset).sum(axis=-1)
    inside = b**2 - a * (offset @ offset - BALL_RADIUS**2)
    ball = np.where(inside > 0, (-b - np.sqrt(np.maximum(inside, 0))) / a, np.inf)
    floor = np.where(rays[..., 2] < -0.01, -camera.T_base_cam[2, 3] / np.minimum(rays[..., 2], -0.01), 6.0)
    return np.minimum(ball, floor).astype(np.float32), ball < floor


def _floor() -> GaussianCloud:
    """Opaque STATIC Gaussians all over the floor."""
    rng, f = np.random.default_rng(0), np.float32
    means = np.concatenate([rng.uniform(-1, 1, (GAUSSIANS, 2)), np.full((GAUSSIANS, 1), 0.01)], axis=1).astype(f)
    quats = np.tile(np.array([1, 0, 0, 0], f), (GAUSSIANS, 1))
    return GaussianCloud(
        means=means,
        quats=quats,
        scales=np.full((GAUSSIANS, 3), 0.01, f),
        opacities=np.full(GAUSSIANS, 0.9, f),
        rgb=np.full((GAUSSIANS, 3), 0.5, f),
        velocities=np.zeros((GAUSSIANS, 3), f),
        tiers=np.full(GAUSSIANS, Tier.STATIC, np.uint8),
        ids=np.arange(GAUSSIANS, dtype=np.uint32),
        nodes=np.full(GAUSSIANS, -1, np.int32),
    )


def _ball_occupancy() -> Occupancy:
    """`COVERED_VOXELS` voxels in five layers of a ball that moves on."""
    centers = GRID.centers(np.arange(GRID.size))
    layers = []
    for number, horizon in enumerate(HORIZONS_NS):
        distance = np.linalg.norm(centers - np.array([0.03 * number, 0.0, 0.7]), axis=1)
        nearest = np.sort(np.argsort(distance, kind="stable")[: COVERED_VOXELS // len(HORIZONS_NS)])
        layers.append(OccupancyLayer(horizon, nearest.astype(np.uint32), np.full(len(nearest), 200, np.uint8)))
    nothing = OccupancyLayer(0, np.zeros(0, np.uint32), np.zeros(0, np.uint8))
    return Occupancy(0, 0, GRID, tuple(layers), nothing, encode_runs(np.zeros(GRID.size, np.bool_)))
