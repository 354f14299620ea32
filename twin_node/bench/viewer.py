"""`twin_node bench viewer`: how soon a log is on the page, and how often what moves is drawn anew for two visitors."""

from __future__ import annotations

import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from twin_node.bench.errors import BenchError
from twin_node.bench.viewer_send import SendCost, cost, middle_of
from twin_node.bench.visitors import BYTES_PER_SPLAT, PATIENCE_S, brings_gaussians, connect_to, free_port, visiting
from twin_node.messages import convert
from twin_node.nodes.snapshot import Snapshot
from twin_node.nodes.topics import GAUSSIANS, GAUSSIANS_MOVING
from twin_node.nodes.viewer import CellPage
from twin_node.nodes.viewer.live import Heard
from twin_node.robot import ur_model
from twin_node.runtime.wire import encoded
from twin_node.scene import GaussianCloud, Tier

VISITORS = 2
ASKED_HZ = 60.0
"""Pictures asked for, per second."""


@dataclass(frozen=True)
class ViewerBenchParameters:
    """What is shown."""

    gaussians: int = 10_000
    moving: int = 1_000
    seconds: float = 5.0
    """How long pictures are counted."""


@dataclass(frozen=True)
class ViewerFigures:
    """How the viewer did."""

    first_picture_s: float | None
    """From the start of `twin_node view` until its Gaussians are with a visitor; None: no log was given."""
    shown_hz: float
    """Pictures per second that the page's own thread has drawn."""
    seen_hz: tuple[float, ...]
    """Updates of the moving Gaussians per second, with each visitor."""
    show_ms: float
    """Time that one picture takes of the thread that draws, median."""
    send: SendCost | None = None
    """What the page costs the thread of the twin that sends; None: no log was given."""

    def as_json(self) -> dict[str, object]:
        """The stable names that `--json` prints."""
        return asdict(self)


def run(log: Path | None = None, parameters: ViewerBenchParameters | None = None) -> ViewerFigures:
    """Measures; `log` is what a twin has written.

    Raises `GraphError` where it lacks a topic, before anything is measured, and `BenchError` where no page or picture
    comes.
    """
    parameters = parameters or ViewerBenchParameters()
    messages = None if log is None else middle_of(log)
    first = None if log is None else _first_picture_s(log)
    port = free_port()
    page = CellPage(ur_model("ur10e"), (), port=port)
    size = parameters.moving * BYTES_PER_SPLAT
    try:
        with visiting(port, VISITORS, range(size, 2 * size)) as visitors:
            for visitor in visitors:
                visitor.wait()
            times = _show_all(page, parameters)
            counts = [visitor.sent().updates for visitor in visitors]
    finally:
        page.close()
    spent = parameters.seconds
    return ViewerFigures(
        first,
        len(times) / spent,
        tuple(n / spent for n in counts),
        1e3 * float(np.median(times)),
        None if messages is None else cost(messages, VISITORS),
    )


def _first_picture_s(log: Path) -> float:
    """From the start of the command until the log's Gaussians are with a visitor."""
    from websockets.exceptions import ConnectionClosed

    port = free_port()
    begun = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-c", "from twin_node.cli import main; main()", "view", str(log), "--port", str(port)],
        stdout=subprocess.DEVNULL,
    )
    try:
        while process.poll() is None and time.perf_counter() - begun < PATIENCE_S:
            with suppress(OSError, ConnectionClosed), connect_to(port) as visitor:
                while not brings_gaussians(visitor.recv(timeout=PATIENCE_S)):
                    pass
                return time.perf_counter() - begun
            time.sleep(0.02)
        raise BenchError(f"{log}: expected a page with its Gaussians, found none; try 'twin_node view {log}'")
    finally:
        process.kill()
        process.wait()


def _show_all(page: CellPage, parameters: ViewerBenchParameters) -> list[float]:
    """Draws at the rate asked for; the time that each picture took, s."""
    cloud = _cloud(parameters)
    moving = cloud.tiers == Tier.RIGID
    whole = Heard(0, encoded(convert.gaussians_to_pointcloud2(cloud, 0)))
    times: list[float] = []
    begun = time.perf_counter()
    while (now := time.perf_counter()) - begun < parameters.seconds:
        stamp = 1 + int((now - begun) * 1e9)
        cloud.means[moving, 0] += np.float32(1e-3)
        said = {
            GAUSSIANS: whole,
            GAUSSIANS_MOVING: Heard(stamp, encoded(convert.gaussians_to_pointcloud2(cloud.only(moving), stamp))),
        }
        page.show(Snapshot(stamp, said, {}, None))
        times.append(time.perf_counter() - now)
        time.sleep(max(1 / ASKED_HZ - times[-1], 0))
    return times


def _cloud(parameters: ViewerBenchParameters) -> GaussianCloud:
    rng = np.random.default_rng(0)
    n = parameters.gaussians
    tiers = np.full(n, Tier.STATIC, np.uint8)
    tiers[: parameters.moving] = Tier.RIGID
    quats = rng.normal(size=(n, 4))
    return GaussianCloud(
        means=rng.uniform(-1, 1, (n, 3)).astype(np.float32),
        quats=(quats / np.linalg.norm(quats, axis=1, keepdims=True)).astype(np.float32),
        scales=rng.uniform(0.003, 0.02, (n, 3)).astype(np.float32),
        opacities=rng.uniform(0.2, 1, n).astype(np.float32),
        rgb=rng.uniform(0, 1, (n, 3)).astype(np.float32),
        velocities=np.zeros((n, 3), np.float32),
        tiers=tiers,
        ids=np.arange(n, dtype=np.uint32),
        nodes=np.full(n, -1, np.int32),
    )
