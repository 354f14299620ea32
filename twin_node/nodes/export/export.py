"""A span of a log into a file of another program: whole, or not at all."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from twin_node.model.ply import write_ply
from twin_node.nodes.export.clouds import write_clouds, write_spz
from twin_node.nodes.export.mjcf import write_collision_scene
from twin_node.nodes.export.moments import ExportError, Moment, Source
from twin_node.nodes.export.tables import write_arm_table, write_arrays, write_obstacle_table
from twin_node.nodes.export.usd import write_stage
from twin_node.nodes.topics import GAUSSIANS, OBSTACLES
from twin_node.robot import ArmModel

Write = Callable[[Sequence[Moment], ArmModel, float, Path], None]


@dataclass(frozen=True)
class ExportSpan:
    """The times of a log that are exported, from its first word on."""

    start_s: float = 0.0
    stop_s: float | None = None
    """None: the end of the log."""
    rate_hz: float = 30.0

    @staticmethod
    def one(at_s: float) -> ExportSpan:
        """A single time."""
        return ExportSpan(at_s, at_s)

    def stamps(self, start_ns: int, end_ns: int) -> list[int]:
        """Log times, ns, of a log from `start_ns` to `end_ns`. Raises `ExportError` for times that it does not have."""
        length = (end_ns - start_ns) / 1e9
        stop = length if self.stop_s is None else self.stop_s
        if not 0 <= self.start_s <= stop <= length + 1e-9:
            raise ExportError(
                f"times {self.start_s:g} to {stop:g} s: expected a span inside the log's 0 to {length:.3f} s; correct "
                "--at, or --start and --stop"
            )
        count = int(np.floor((stop - self.start_s) * self.rate_hz + 1e-9)) + 1
        return [start_ns + round((self.start_s + k / self.rate_hz) * 1e9) for k in range(count)]


@dataclass(frozen=True)
class Format:
    """One kind of file."""

    suffixes: tuple[str, ...]
    """What its name may end in; none: a folder."""
    topic: str
    """What it is made of, and cannot do without."""
    write: Write

    @property
    def with_clouds(self) -> bool:
        """Whether Gaussians go into it."""
        return self.topic == GAUSSIANS


def export(
    source: Source, form: str, span: ExportSpan, arm: ArmModel, output: Path, progress: Callable[[int, int], None]
) -> int:
    """Writes a span of a source as one of `FORMATS` to `output`; returns the number of moments written.

    `progress(done, total)` counts moments read. Nothing is left behind by an export that fails. Raises `ExportError`
    for a format, a name or a span that does not fit, and `GraphError` for a log without what the format needs.
    """
    chosen = _format(form, output)
    source.require(chosen.topic, f"an export to {form}")
    stamps = span.stamps(source.start_ns, source.end_ns)
    taken = []
    for moment in source.moments(stamps, arm, chosen.with_clouds or form == "usd"):
        taken.append(moment)
        progress(len(taken), len(stamps))
    with _whole(output) as unfinished:
        chosen.write(taken, arm, span.rate_hz, unfinished)
    return len(taken)


def _format(form: str, output: Path) -> Format:
    if form not in FORMATS:
        raise ExportError(f"--to {form}: expected one of {', '.join(FORMATS)}")
    chosen = FORMATS[form]
    if chosen.suffixes and output.suffix not in chosen.suffixes:
        raise ExportError(f"-o {output}: expected a name that ends in {' or '.join(chosen.suffixes)} for {form}")
    return chosen


@contextlib.contextmanager
def _whole(output: Path) -> Iterator[Path]:
    """A path to write to under `output`'s name, and beside it; all of it moves to `output`'s folder at the end."""
    folder = output.with_name(f".{output.name}.partial")
    try:
        shutil.rmtree(folder, ignore_errors=True)
        folder.mkdir()
        yield folder / output.name
        for made in folder.iterdir():
            target = output.with_name(made.name)
            if made.is_dir():
                shutil.rmtree(target, ignore_errors=True)
            made.replace(target)
    except OSError as error:
        raise ExportError(f"-o {output}: cannot be written ({error.strerror}); choose a folder that exists") from None
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def _write_tables(taken: Sequence[Moment], arm: ArmModel, _rate_hz: float, path: Path) -> None:
    path.mkdir()
    write_obstacle_table(taken, path / "obstacles.csv")
    write_arm_table(taken, arm, path / "arm.csv")


FORMATS: Mapping[str, Format] = {
    "ply": Format((".ply",), GAUSSIANS, lambda taken, _arm, _hz, path: write_clouds(taken, path, write_ply)),
    "spz": Format((".spz",), GAUSSIANS, lambda taken, _arm, _hz, path: write_clouds(taken, path, write_spz)),
    "npz": Format((".npz",), GAUSSIANS, lambda taken, _arm, _hz, path: write_arrays(taken, path)),
    "mjcf": Format((".xml",), OBSTACLES, lambda taken, arm, _hz, path: write_collision_scene(taken, arm, path)),
    "usd": Format((".usd", ".usda", ".usdc"), OBSTACLES, write_stage),
    "csv": Format((), OBSTACLES, _write_tables),
}
