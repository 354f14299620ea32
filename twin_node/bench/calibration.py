"""How well made-up rigs are calibrated from a board: errors against the truth, and whether the stated errors hold."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable
from dataclasses import asdict, astuple, dataclass
from time import perf_counter

import numpy as np
from scipy.spatial.transform import Rotation
from scipy.stats import chi2

from twin_node.bench.errors import BenchError
from twin_node.bench.simulated_rigs import BOARD, START_NS, RigSpread, SimulatedRig, simulated_rig
from twin_node.bench.text_table import figure, text_table
from twin_node.bench.workers import spread
from twin_node.geometry import pose, transform
from twin_node.rig.calibrate.extrinsics import RigSolution, calibrate_rig
from twin_node.rig.calibrate.lenses import project
from twin_node.rig.calibrate.results import camera_poses, pose_covariances, residuals_of_all, settled
from twin_node.scene import Float64

ELLIPSOID = 0.99
"""Probability that stated ellipsoids are drawn for."""

ALIGNMENT_ROUNDS = 5
"""Newton's steps of laying one rig over another: the third moves nothing."""

WORKERS = 2
"""Rigs that are worked on at once by default."""


@dataclass(frozen=True)
class RigErrors:
    """One rig against its truth; worst of its cameras."""

    seed: int
    cameras: int
    median_reprojection_px: float
    position_mm: float
    """Of a camera, the rig as a whole laid over the true one."""
    turn_deg: float
    sight_mm: float
    """Between where a camera is said to see points of the cell and where it sees them, pose and lens together (rms)."""
    offset_ms: float
    """Of a clock against the first camera's, at the middle of the recording."""
    rate_ppm: float
    poses_inside: int
    """Cameras whose true pose (six numbers) is inside the stated 99 % ellipsoid."""
    clocks_inside: int
    """Cameras but the first whose true offset and rate are inside the stated 99 % ellipse."""


@dataclass(frozen=True)
class CalibrationBench:
    """All rigs."""

    rigs: tuple[RigErrors, ...]
    seconds: float

    def as_json(self) -> dict[str, object]:
        """What `--json` prints."""
        cameras = sum(rig.cameras for rig in self.rigs)
        clocks = sum(rig.clocks_inside for rig in self.rigs)
        worst = {
            name: max(float(getattr(rig, name)) for rig in self.rigs)
            for name in ("position_mm", "turn_deg", "sight_mm", "offset_ms", "rate_ppm")
        }
        median = {name: float(np.median([getattr(rig, name) for rig in self.rigs])) for name in worst}
        return {
            "rigs": len(self.rigs),
            "cameras": cameras,
            "worst": worst,
            "median": median,
            "ellipsoid_coverage": self.coverage,
            "clock_coverage": clocks / max(cameras - len(self.rigs), 1),
            "seconds": self.seconds,
            "each": [asdict(rig) for rig in self.rigs],
        }

    def table(self) -> str:
        """For people: a line per rig, then the share of true poses that are where they were said to be."""
        heads = ("rig", "cameras", "median px", "position mm", "turn deg", "sight mm", "offset ms", "rate ppm")
        rows = ((*map(figure, astuple(rig)[:8]), f"{rig.poses_inside} of {rig.cameras}") for rig in self.rigs)
        cameras = sum(rig.cameras for rig in self.rigs)
        last = (
            f"stated 99 % ellipsoids hold {100 * self.coverage:.1f} % of {cameras} poses; "
            f"{self.seconds:.0f} s for {len(self.rigs)} rigs"
        )
        return f"{text_table((*heads, 'inside 99 %'), rows)}\n{last}"

    @property
    def coverage(self) -> float:
        """Share of all cameras' true poses that are inside their stated ellipsoids."""
        return sum(rig.poses_inside for rig in self.rigs) / sum(rig.cameras for rig in self.rigs)


def run(
    rigs: int,
    seed: int,
    processes: int = WORKERS,
    progress: Callable[[Iterable[RigErrors]], Iterable[RigErrors]] = iter,
) -> CalibrationBench:
    """Calibrates so many rigs, numbered from `seed`; the same numbers are the same rigs.

    Raises `BenchError` for fewer than one rig.
    """
    if rigs < 1:
        raise BenchError(f"bench calibration: expected at least one rig, found {rigs}")
    start, seeds = perf_counter(), range(seed, seed + rigs)
    if processes > 1:
        os.environ["OMP_NUM_THREADS"] = "1"  # processes share the cores instead of fighting for them
    results = tuple(progress(spread(measure, seeds, processes)))
    return CalibrationBench(results, perf_counter() - start)


def measure(seed: int) -> RigErrors:
    """One rig, made and calibrated with nothing known of it but the board."""
    rig = simulated_rig(RigSpread(), np.random.default_rng(seed))
    solution = calibrate_rig(BOARD, rig.recordings)
    found = laid_over(camera_poses(solution.bundle.state), rig.T_base_cam)
    errors = differences(found, rig.T_base_cam)
    to_base = found[0] @ np.linalg.inv(camera_poses(solution.bundle.state)[0])
    covariances = pose_covariances(solution, to_base)
    distances = [error @ np.linalg.solve(C, error) for error, C in zip(errors, covariances, strict=True)]
    clocks = clock_errors(solution, rig)
    return RigErrors(
        seed,
        len(found),
        residuals_of_all(solution.bundle.residuals).median_px,
        1e3 * float(np.linalg.norm(errors[:, :3], axis=1).max()),
        float(np.degrees(np.linalg.norm(errors[:, 3:], axis=1)).max()),
        1e3 * float(sight_errors(solution, rig, found).max()),
        1e3 * float(np.abs(clocks[:, 0]).max()),
        1e6 * float(np.abs(clocks[:, 1]).max()),
        int((np.array(distances) < chi2.ppf(ELLIPSOID, 6)).sum()),
        _clocks_inside(solution, clocks),
    )


def laid_over(found: Float64, truth: Float64) -> Float64:
    """Poses [C, 4, 4] moved as a whole to where they differ least from others."""
    for _ in range(ALIGNMENT_ROUNDS):
        errors = differences(found, truth)
        shared = errors[0] - settled(truth, errors.reshape(-1, 1)).reshape(-1, 6)[0]
        turn = Rotation.from_rotvec(-shared[3:]).as_matrix()
        centre = found[0, :3, 3]
        found = pose(turn, centre - turn @ centre - shared[:3]) @ found
    return found


def differences(found: Float64, truth: Float64) -> Float64:
    """[C, 6] position (m) and turn about the base's axes (rad) from true poses [C, 4, 4] to others."""
    turns = Rotation.from_matrix(found[:, :3, :3] @ truth[:, :3, :3].swapaxes(1, 2)).as_rotvec()
    return np.concatenate([found[:, :3, 3] - truth[:, :3, 3], turns], axis=1)


def sight_errors(solution: RigSolution, rig: SimulatedRig, found: Float64) -> Float64:
    """[C] root mean square, m, across the line of sight, over points about the middle of the cell."""
    points = np.random.default_rng(0).uniform(-0.4, 0.4, (200, 3))
    out = []
    for i, true_lens in enumerate(rig.lenses):
        lens = solution.bundle.state.lenses[i]
        truly = transform(np.linalg.inv(rig.T_base_cam[i]), points)
        off = project(lens, transform(np.linalg.inv(found[i]), points)).pixels - project(true_lens, truly).pixels
        out.append(np.sqrt(((off / true_lens.K[0, 0] * truly[:, 2:]) ** 2).sum(1).mean()))
    return np.array(out)


def clock_errors(solution: RigSolution, rig: SimulatedRig) -> Float64:
    """[C - 1, 2] errors of the clocks' offsets (s) and rates against the first camera's, at the reference stamp."""
    since = (solution.reference_ns - START_NS) / 1e9
    rates = rig.rates_ppm * 1e-6
    true_time = since + rig.offsets_s + rates * since
    offsets = (true_time - rig.offsets_s[0]) / (1 + rates[0]) - since
    truth = np.stack([offsets, (1 + rates) / (1 + rates[0]) - 1], axis=1)
    return np.asarray(solution.bundle.state.clocks - truth)[1:]


def _clocks_inside(solution: RigSolution, errors: Float64) -> int:
    layout, inside = solution.bundle.layout, 0
    for i, error in enumerate(errors, start=1):
        C = solution.bundle.covariance[layout.clock(i), layout.clock(i)]
        inside += bool(error @ np.linalg.solve(C, error) < chi2.ppf(ELLIPSOID, 2))
    return inside
