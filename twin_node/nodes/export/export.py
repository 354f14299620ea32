"""A span of a log into a file of another program: whole, or not at all."""

from __future__ import annotations

import contextlib
import shutil
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

import numpy as np

from twin_node.nodes.export.arrays import write_arrays
from twin_node.nodes.export.clouds import write_clouds, write_ply, write_spz
from twin_node.nodes.export.mjcf import write_collision_scene
from twin_node.nodes.export.moments import ExportError, Moments, Source
from twin_node.nodes.export.tables import write_tables
from twin_node.nodes.export.usd import write_stage
from twin_node.nodes.topics import GAUSSIANS, OBSTACLES
from twin_node.ranges import within_s
from twin_node.robot import ArmModel
from twin_node.unfinished import partial_of, refuse_taken, unwritable

Write = Callable[[Moments, Path], None]


@dataclass(frozen=True)
class ExportSpan:
    """The times of a log that are exported, from its first word on."""

    start_s: float = 0.0
    stop_s: float | None = None
    """None: the end of the log, where a range that goes on beyond it ends, too."""
    rate_hz: float = 30.0

    @staticmethod
    def one(at_s: float) -> ExportSpan:
        """A single time."""
        return ExportSpan(at_s, at_s)

    def __str__(self) -> str:
        """The times, as they were asked for."""
        if self.stop_s is None:
            return f"from {self.start_s:g} s"
        return f"at {self.start_s:g} s" if self.stop_s == self.start_s else f"{self.start_s:g} to {self.stop_s:g} s"

    def stamps(self, start_ns: int, end_ns: int) -> list[int]:
        """Log times, ns, of a log from `start_ns` to `end_ns`. Raises `ExportError` for times that it does not have."""
        length = (end_ns - start_ns) / 1e9
        stop = length if self.stop_s is None else self.stop_s
        if stop > self.start_s:
            stop = min(stop, length)
        if not 0 <= self.start_s <= stop <= length + 1e-9:
            raise ExportError(
                f"{self}: expected a span inside the log's {within_s(length)}; correct --at, or --start and --stop"
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
    with_clouds: bool
    """Whether Gaussians go into it."""
    with_arm: bool
    """Whether the arm goes into it: whose joints the log has is asked only then."""
    is_split: bool = False
    """Whether each moment is a file of its own: more than one are a folder."""

    def is_folder(self, moments: int) -> bool:
        """Whether so many moments are a folder."""
        return not self.suffixes or (self.is_split and moments > 1)


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
    moments = Moments(
        source,
        stamps,
        arm,
        span.rate_hz,
        chosen.with_clouds,
        chosen.with_arm,
        lambda count: progress(count, len(stamps)),
    )
    with _whole(output, chosen.is_folder(len(stamps))) as unfinished:
        chosen.write(moments, unfinished)
    return len(stamps)


def _format(form: str, output: Path) -> Format:
    if form not in FORMATS:
        raise ExportError(f"--to {form}: expected one of {', '.join(FORMATS)}")
    chosen = FORMATS[form]
    if chosen.suffixes and output.suffix not in chosen.suffixes:
        raise ExportError(f"-o {output}: expected a name that ends in {' or '.join(chosen.suffixes)} for {form}")
    return chosen


@contextlib.contextmanager
def _whole(output: Path, is_folder: bool) -> Iterator[Path]:
    """A path to write to under `output`'s name, and beside it; all of it moves to `output`'s folder at the end.

    A file is replaced by a file; a folder is not, there may be more in it than an earlier export.
    """
    if not output.name or output.is_dir():
        raise ExportError(f"-o {output}: expected a new name, found a folder that exists; choose another, or delete it")
    if is_folder and output.exists():
        raise ExportError(f"-o {output}: expected the name of a new folder, found a file; choose another, or delete it")
    folder = partial_of(output)
    refuse_taken(output, ExportError)
    try:
        folder.mkdir()
    except OSError as error:
        raise ExportError(f"-o {unwritable(output, error)}") from None
    try:
        yield folder / output.name
        places = {made: output.with_name(made.name) for made in folder.iterdir()}
        for place in places.values():
            if place.is_dir():  # before anything is replaced: what belongs together stays together
                raise ExportError(f"-o {output}: writes {place} too, found a folder of that name; choose another name")
        for made, place in places.items():
            made.replace(place)
    except OSError as error:
        raise ExportError(f"-o {unwritable(output, error)}") from None
    finally:
        shutil.rmtree(folder, ignore_errors=True)


FORMATS: Mapping[str, Format] = {
    "ply": Format(
        (".ply",), GAUSSIANS, partial(write_clouds, write=write_ply), with_clouds=True, with_arm=False, is_split=True
    ),
    "spz": Format(
        (".spz",), GAUSSIANS, partial(write_clouds, write=write_spz), with_clouds=True, with_arm=False, is_split=True
    ),
    "npz": Format((".npz",), GAUSSIANS, write_arrays, with_clouds=True, with_arm=False),
    "mjcf": Format((".xml",), OBSTACLES, write_collision_scene, with_clouds=False, with_arm=True),
    "usd": Format((".usd", ".usda", ".usdc"), OBSTACLES, write_stage, with_clouds=True, with_arm=True),
    "csv": Format((), OBSTACLES, write_tables, with_clouds=False, with_arm=True),
}
