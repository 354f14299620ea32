"""`twin_node bench methods`: every method on the same images, scored on the same others."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass, field

from twin_node.bench.errors import BenchError
from twin_node.bench.methods.frozen import fit_frozen
from twin_node.bench.methods.online import fit_online
from twin_node.bench.methods.per_frame import fit_per_frame
from twin_node.bench.methods.plane_nerf import fit_nerf
from twin_node.bench.methods.previous import fit_previous
from twin_node.bench.methods.protocol import Budget, Method
from twin_node.bench.methods.scores import ImageScores, score_images
from twin_node.bench.methods.streaming import fit_streaming
from twin_node.bench.methods.truth import MotionTruth, track_errors_mm
from twin_node.bench.methods.whole_sequence import fit_hash, fit_hexplane, fit_plain
from twin_node.model.sequence import Recording
from twin_node.model.sequence.scoring import evenly
from twin_node.nodes.report.quality import unit
from twin_node.scene import Float32, View

METHODS: Mapping[str, Method] = {
    "frozen": Method("frozen first frame", fit_frozen, online=True),
    "previous": Method("the camera's previous image", fit_previous, online=True),
    "per_frame_3dgs": Method("3DGS per frame", fit_per_frame, online=True),
    "dynamic_nerf": Method("dynamic NeRF on planes", fit_nerf, online=False),
    "streaming": Method("3DGStream-style", fit_streaming, online=True),
    "4dgs_hexplane": Method("4DGS, HexPlane", fit_hexplane, online=False, takes_steps=True),
    "4dgs_hash": Method("4DGS, hash grid", fit_hash, online=False, takes_steps=True),
    "static_3dgs": Method("3DGS of all frames, no field", fit_plain, online=False, takes_steps=True),
    "ours": Method("ours, online", fit_online, online=True),
}
"""By the names that `--json` prints."""

SCORED = 24
"""Held-out images that are scored, at most, evenly over time: a NeRF takes a second for each."""

Report = Callable[[str, float], None]
"""Called with a method's name and the share of its work that is done."""


@dataclass(frozen=True)
class MethodRow:
    """One line of the table."""

    title: str
    online: bool
    scores: ImageScores
    learn_ms_per_frame: float
    """Wall-clock time of learning over the time steps of the recording."""
    bytes: int | None
    parameters: int | None
    track_mm: Mapping[str, float]
    """Error of followed surface points, per mover and in all; empty without motion or without truth."""
    notes: Mapping[str, float]


@dataclass(frozen=True)
class MethodsBench:
    """The whole table."""

    data: str
    frames: int
    training_images: int
    scored_images: int
    size: str
    rows: Mapping[str, MethodRow]
    ablations: Mapping[str, float] = field(default_factory=dict)
    """Figures of further scenes that show one kind of motion alone."""

    @property
    def ours_less_offline_db(self) -> float | None:
        """Moving pixels: ours online less the better of the two 4DGS trained offline; None where not all were run."""
        ours = self._moving("ours")
        offline = [value for value in (self._moving("4dgs_hexplane"), self._moving("4dgs_hash")) if value is not None]
        return None if ours is None or not offline else ours - max(offline)

    def as_json(self) -> dict[str, object]:
        """The stable names that `--json` prints."""
        rows = {
            name: {
                "title": row.title,
                "online": row.online,
                **asdict(row.scores),
                "learn_ms_per_frame": row.learn_ms_per_frame,
                "bytes": row.bytes,
                "parameters": row.parameters,
                "track_mm": dict(row.track_mm),
                "notes": dict(row.notes),
            }
            for name, row in self.rows.items()
        }
        return {
            "data": self.data,
            "frames": self.frames,
            "training_images": self.training_images,
            "scored_images": self.scored_images,
            "size": self.size,
            "methods": rows,
            "ours_less_offline_moving_db": self.ours_less_offline_db,
            "ablations": dict(self.ablations),
        }

    def _moving(self, name: str) -> float | None:
        return self.rows[name].scores.psnr_moving_db if name in self.rows else None


def run(
    recording: Recording, truth: MotionTruth | None, budget: Budget, names: tuple[str, ...], report: Report
) -> MethodsBench:
    """Fits each method to the training images and scores it on the held-out ones.

    Raises `BenchError` where nothing is held out, the cameras move or stand alone, or a method is not known.
    """
    check_names(names)
    _check(recording)
    first: dict[str, Float32] = {}
    for view in recording.held_out:
        first.setdefault(view.camera.name, unit(view))
    scored = evenly(recording.held_out, SCORED)
    rows = {name: _row(METHODS[name], name, recording, truth, budget, scored, first, report) for name in names}
    camera = recording.train[0].camera
    size = f"{camera.width}x{camera.height}"
    return MethodsBench(recording.name, recording.steps, len(recording.train), len(scored), size, rows)


def _row(
    method: Method,
    name: str,
    recording: Recording,
    truth: MotionTruth | None,
    budget: Budget,
    scored: tuple[View, ...],
    first: dict[str, Float32],
    report: Report,
) -> MethodRow:
    begun = time.perf_counter()
    fitted = method.fit(recording, budget, lambda share: report(name, share))
    learn_ms = 1e3 * (time.perf_counter() - begun) / recording.steps
    scores = score_images(fitted, scored, first)
    track = {} if truth is None else track_errors_mm(truth, fitted.follow)
    return MethodRow(
        method.title, method.online, scores, learn_ms, fitted.bytes, fitted.parameters, track, fitted.notes
    )


def check_names(names: tuple[str, ...]) -> None:
    """Raises `BenchError` for a name that is not in `METHODS`."""
    for name in names:
        if name not in METHODS:
            raise BenchError(f"--methods: expected some of {', '.join(METHODS)}, found '{name}'")


def _check(recording: Recording) -> None:
    if not recording.held_out:
        raise BenchError(f"{recording.name}: expected a held-out camera to score on; name one with --hold-out")
    if recording.camera_moves:
        raise BenchError(
            f"{recording.name}: expected two or more cameras that stand still, found {len(recording.cameras)} "
            f"with {len(recording.train)} images; use twin_node train for moving cameras"
        )
    if len(recording.cameras) < 2:
        raise BenchError(
            f"{recording.name}: expected two or more cameras beside those held out, found {recording.cameras[0].name} "
            "alone; hold out fewer, or take a recording of more cameras"
        )
