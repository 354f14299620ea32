"""What a recorder keeps: three cameras at 30 Hz, and what is left when it is killed."""

from __future__ import annotations

import multiprocessing
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin_node.bag import BagError, RecordingWriter, open_log
from twin_node.bench.errors import BenchError
from twin_node.bench.graph_run import cpu_s, running
from twin_node.messages import builtin_types, convert
from twin_node.nodes.launch.launch_file import read_launch_file
from twin_node.runtime.wire import Encoded, encoded

CAMERAS = ("back", "front", "left")
WIDTH, HEIGHT, RATE_HZ = 640, 480, 30.0


@dataclass(frozen=True)
class RecorderFigures:
    """Three cameras 640x480 at 30 Hz, JPEG and PNG compressedDepth, over loopback into a recorder's process."""

    seconds: float
    sent: int
    written: int
    dropped: int
    megabytes_per_s: float
    core_share: float
    """Processor time of the recorder's process, share of one core."""


@dataclass(frozen=True)
class KilledFigures:
    """Recorders killed at random moments."""

    kills: int
    opened: int
    """Files that could be opened."""
    lost_s_max: float
    """Longest time before the kill that a file lacks, of those that could be opened, s."""


def images() -> list[tuple[str, Encoded]]:
    """One image of each camera and its depth, encoded as they come from cameras: textured, with noise."""
    rng = np.random.default_rng(0)
    made = []
    for camera in CAMERAS:
        coarse = rng.integers(0, 255, (HEIGHT // 16, WIDTH // 16, 3), dtype=np.uint8)
        rgb = coarse.repeat(16, axis=0).repeat(16, axis=1) // 2 + rng.integers(
            0, 12, (HEIGHT, WIDTH, 3), dtype=np.uint8
        )
        depth = (1.0 + coarse[..., 0].repeat(16, axis=0).repeat(16, axis=1) / 255.0).astype(np.float32)
        depth += rng.normal(0.0, 0.002, depth.shape).astype(np.float32)
        made.append((f"/{camera}/image_raw/compressed", encoded(convert.compressed_image(camera, 0, rgb))))
        made.append(
            (f"/{camera}/depth/image_rect/compressedDepth", encoded(convert.compressed_depth_image(camera, 0, depth)))
        )
    return made


def record_until_killed(path: str) -> None:
    """Writes the cameras' images at their rate, stamped by the wall clock, until the process is killed."""
    made, types = images(), builtin_types()
    with RecordingWriter(Path(path)) as writer:
        while True:
            for topic, message in made:
                writer.write(topic, message.msgtype, message.data, time.time_ns(), types)
            time.sleep(1 / RATE_HZ)


def killed(times: int, folder: Path) -> KilledFigures:
    """Kills `times` recorders after a random 0.8 to 3 s, and opens what they leave.

    Raises `BenchError` where a recorder ends by itself, or none leaves anything.
    """
    rng = np.random.default_rng(1)
    lost, opened = [], 0
    for i in range(times):
        path = folder / f"killed_{i}.mcap"
        at = _killed_at(path, float(rng.uniform(0.8, 3.0)))
        try:
            with open_log(path) as log:
                opened += any(True for _ in log.messages())
                lost.append((at - log.end_ns) / 1e9)
        except BagError:  # it is not counted as opened
            continue
    if not lost:
        raise BenchError(f"{folder}: expected killed recorders to leave files that open, found none of {times}")
    return KilledFigures(times, opened, max(lost))


def _killed_at(path: Path, after_s: float) -> int:
    """When a recorder was killed that had written for so long, ns; however this ends, none is left."""
    process = multiprocessing.get_context("spawn").Process(target=record_until_killed, args=(str(path),))
    process.start()
    try:
        while not (path.exists() and path.stat().st_size > 1000):
            if not process.is_alive():
                raise BenchError(f"{path}: expected a recorder to write it, found that it ended; is there room?")
            time.sleep(0.01)
        time.sleep(after_s)
        return time.time_ns()
    finally:
        process.kill()
        process.join()


RECORDER_ALONE = """
launch:
  processes:
    recorder: {{nodes: [recorder]}}
recorder:
  ros__parameters:
    output: {output}
    topics: [{topics}]
"""


def recorded(seconds: float, folder: Path) -> RecorderFigures:
    """Sends the cameras' images at their rate to a recorder in a process of its own, and counts what it has written."""
    made = images()
    folder.mkdir()
    launch, output = folder / "recorder.yaml", folder / "out"
    launch.write_text(RECORDER_ALONE.format(output=output, topics=", ".join(topic for topic, _ in made)))
    sent = 0
    with running(read_launch_file(launch)) as run:
        run.spin(1.0)
        recorder = run.launcher.children()["recorder"]
        spent = cpu_s(recorder)
        begun = due = time.monotonic()
        while due < begun + seconds:
            for topic, message in made:
                run.bus.publish(topic, message)
                sent += 1
            due += 1 / RATE_HZ
            run.spin(due - time.monotonic())
        spent = (cpu_s(recorder) - spent) / (time.monotonic() - begun)
        run.spin(1.0)
    with open_log(output) as log:
        written = sum(topic.count for topic in log.topics)
    size = sum(path.stat().st_size for path in output.iterdir())
    return RecorderFigures(seconds, sent, written, sent - written, size / 1e6 / seconds, spent)
