"""Scenarios read from YAML files, which may extend each other."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from twin_node import resources
from twin_node.cell.errors import CellError
from twin_node.cell.scenario import Scenario
from twin_node.errors import kind_of
from twin_node.runtime.parameters import ParameterError, fill
from twin_node.yaml_file import read_yaml


def load_scenario(name: str | Path) -> Scenario:
    """Read a scenario from a YAML file, as given or below the `sim` data folder (`demo`, `sim/demo.yaml`).

    `extends: NAME` takes what the file does not set itself from NAME.yaml beside it, which may extend another.
    Raises `CellError` naming the file and the key for anything unknown or out of range, and `ResourceError` where the
    file does not exist.
    """
    path = _find(name)
    content = _whole(path)
    try:
        return _with_files(fill(Scenario, content, str(path)), path.parent)
    except ParameterError as error:
        raise CellError(str(error)) from error
    except CellError as error:
        raise CellError(f"{path}: {error}") from error


def _with_files(scenario: Scenario, folder: Path) -> Scenario:
    """The scenario with the files it names found beside it."""
    people = tuple(
        person
        if person.motion is None
        else replace(person, motion=replace(person.motion, file=str(_beside(folder, person.motion.file))))
        for person in scenario.people
    )
    return replace(scenario, people=people)


def _beside(folder: Path, name: str) -> Path:
    """A file beside the scenario, else as given from here; raises `CellError` where there is neither."""
    for path in (folder / name, Path(name)):
        if _is_file(path):
            return path.resolve()
    known = ", ".join(sorted(file.name for file in folder.glob("*.bvh"))) or "none"
    raise CellError(f"motion: no file '{name}' beside the scenario or here; beside it are: {known}")


def _read(path: Path) -> dict[str, object]:
    content = read_yaml(path, "a scenario (YAML)", CellError)
    if not isinstance(content, dict):
        raise CellError(f"{path}: expected a scenario's keys and values, found {kind_of(content)}")
    _require_finite(content, path)
    return content


def _require_finite(value: object, file: Path, key: str = "") -> None:
    """Raises `CellError`, naming file and key, for a number that is infinite or none."""
    if isinstance(value, Mapping):
        for name, inner in value.items():
            _require_finite(inner, file, f"{key}.{name}" if key else str(name))
    elif isinstance(value, list):
        for i, inner in enumerate(value):
            _require_finite(inner, file, f"{key}[{i}]")
    elif isinstance(value, float) and not math.isfinite(value):
        raise CellError(f"{file}: {key}: expected a finite number, found {value}; leave out what has no end")


def _whole(path: Path, below: tuple[Path, ...] = ()) -> dict[str, object]:
    """What a file sets, and what those that it extends set besides. `below`: the files that led to it."""
    content = _read(path)
    if "extends" not in content:
        return content
    base = _base(path, content.pop("extends"))
    if any(base.samefile(one) for one in (*below, path)):
        raise CellError(f"{path}: extends '{base.stem}', which extends it in turn; take one of the two out")
    return {**_whole(base, (*below, path)), **content}


def _base(path: Path, name: object) -> Path:
    base = path.parent / f"{name}.yaml"
    if not base.is_file():
        known = ", ".join(sorted(file.stem for file in path.parent.glob("*.yaml") if file != path))
        raise CellError(f"{path}: extends '{name}', but {base} does not exist; beside it are: {known or 'none'}")
    return base


def _find(name: str | Path) -> Path:
    bare = Path(name)
    return resources.find(bare if bare.suffix or _is_file(bare) else f"sim/{bare}.yaml")


def _is_file(path: Path) -> bool:
    """Whether a file is there; none is by a name that none can have."""
    try:
        return path.is_file()
    except OSError:
        return False
