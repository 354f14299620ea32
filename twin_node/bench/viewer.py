"""`twin_node bench viewer`: how soon a log is on the page, and how often what moves is drawn anew for two visitors."""

from __future__ import annotations

import multiprocessing
import socket
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any

import numpy as np

from twin_node.bench.errors import BenchError
from twin_node.messages import convert
from twin_node.nodes.playback import Snapshot
from twin_node.nodes.topics import GAUSSIANS, GAUSSIANS_MOVING
from twin_node.nodes.viewer import CellPage
from twin_node.nodes.viewer.live import Heard
from twin_node.robot import ur_model
from twin_node.runtime.wire import encoded
from twin_node.scene import GaussianCloud, Tier

BYTES_PER_SPLAT = 32
"""What viser sends of a Gaussian."""
PATIENCE_S = 60.0
"""Longest wait for a page or a picture."""


@dataclass(frozen=True)
class ViewerBenchParameters:
    """What is shown."""

    gaussians: int = 10_000
    moving: int = 1_000
    visitors: int = 2
    seconds: float = 5.0
    """How long pictures are counted."""
    asked_hz: float = 60.0
    """Pictures asked for, per second."""


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

    def as_json(self) -> dict[str, object]:
        """The stable names that `--json` prints."""
        return asdict(self)


def run(log: Path | None = None, parameters: ViewerBenchParameters | None = None) -> ViewerFigures:
    """Measures; `log` is what a twin has written. Raises `BenchError` where no page or picture comes."""
    parameters = parameters or ViewerBenchParameters()
    first = None if log is None else _first_picture_s(log)
    port = _free_port()
    page = CellPage(ur_model("ur10e"), (), port=port)
    try:
        with _visitors(port, parameters) as pipes:
            times = _show_all(page, parameters)
            counts = [_count_of(pipe) for pipe in pipes]
    finally:
        page.close()
    spent = parameters.seconds
    return ViewerFigures(first, len(times) / spent, tuple(n / spent for n in counts), 1e3 * float(np.median(times)))


def _first_picture_s(log: Path) -> float:
    """From the start of the command until a message as large as the log's cloud is with a visitor."""
    from websockets.sync.client import connect

    port = _free_port()
    begun = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-c", "from twin_node.cli import main; main()", "view", str(log), "--port", str(port)],
        stdout=subprocess.DEVNULL,
    )
    try:
        while True:
            if process.poll() is not None or time.perf_counter() - begun > PATIENCE_S:
                raise BenchError(f"{log}: expected a page, found none; try 'twin_node view {log}'")
            try:
                with connect(f"ws://127.0.0.1:{port}", max_size=None, subprotocols=[_protocol()]) as visitor:
                    while len(visitor.recv(timeout=PATIENCE_S)) < 1000 * BYTES_PER_SPLAT:
                        pass
                    return time.perf_counter() - begun
            except OSError:
                time.sleep(0.02)
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
        time.sleep(max(1 / parameters.asked_hz - times[-1], 0))
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


@contextmanager
def _visitors(port: int, parameters: ViewerBenchParameters) -> Iterator[list[Connection]]:
    """Processes that watch the page; each says when it is connected and, at the end, what it has counted."""
    spawn = multiprocessing.get_context("spawn")  # nothing may fork after OpenMP has started
    pipes, processes = [], []
    for _ in range(parameters.visitors):
        ours, theirs = spawn.Pipe()
        process = spawn.Process(target=_watch, args=(port, parameters, theirs), daemon=True)
        process.start()
        pipes.append(ours)
        processes.append(process)
    try:
        for pipe in pipes:
            _count_of(pipe)
        yield pipes
    finally:
        for process in processes:
            process.kill()
            process.join()


def _watch(port: int, parameters: ViewerBenchParameters, pipe: Connection) -> None:
    """A visitor: counts messages that hold the moving Gaussians for as long as pictures come."""
    from websockets.sync.client import connect

    size = parameters.moving * BYTES_PER_SPLAT
    with connect(f"ws://127.0.0.1:{port}", max_size=None, subprotocols=[_protocol()]) as page:
        pipe.send(0)
        count = 0
        try:
            while True:
                length = len(page.recv(timeout=2.0))
                count += size <= length < 2 * size
        except TimeoutError:
            pipe.send(count)
            pipe.poll(None)


def _count_of(pipe: Connection) -> int:
    if not pipe.poll(PATIENCE_S):
        raise BenchError("viewer: expected a visitor to answer, found silence; is the machine overloaded?")
    count: int = pipe.recv()
    return count


def _protocol() -> Any:
    """Viser asks its visitors for the version that they speak."""
    import viser
    from websockets.typing import Subprotocol

    return Subprotocol(f"viser-v{viser.__version__}")


def _free_port() -> int:
    with socket.create_server(("127.0.0.1", 0)) as server:
        return int(server.getsockname()[1])
