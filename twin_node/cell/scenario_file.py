"""Scenarios read from YAML files, which may extend each other."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

from twin_node import resources
from twin_node.arm.errors import ArmError
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
    files = _with_bases(path)
    content = {key: value for file in reversed(files) for key, value in file.content.items()}
    whose = next((file.path for file in files if "people" in file.content), path)
    try:
        return _with_files(fill(Scenario, content, str(path)), (whose.parent, path.parent))
    except ParameterError as error:
        raise CellError(str(error)) from error
    except (CellError, ArmError) as error:
        raise CellError(f"{path}: {error}") from error


@dataclass(frozen=True)
class _File:
    path: Path
    content: dict[str, object]
    """What it sets itself."""


def _with_files(scenario: Scenario, folders: tuple[Path, ...]) -> Scenario:
    """The scenario with the files it names found in the first of these folders that has them."""
    people = tuple(
        person
        if person.motion is None
        else replace(person, motion=replace(person.motion, file=str(_beside(folders, person.motion.file))))
        for person in scenario.people
    )
    return replace(scenario, people=people)


def _beside(folders: tuple[Path, ...], name: str) -> Path:
    """A file in one of the folders, else as given from here; raises `CellError` where there is none."""
    for path in (*(folder / name for folder in folders), Path(name)):
        if _is_file(path):
            return path.resolve()
    known = ", ".join(sorted(file.name for file in folders[0].glob("*.bvh"))) or "none"
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


def _with_bases(path: Path) -> list[_File]:
    """A file, the one that it extends, the one that this extends, and so on."""
    files = [_File(path, _read(path))]
    while "extends" in files[-1].content:
        last = files[-1]
        base = _base(last.path, last.content.pop("extends"))
        if any(base.samefile(file.path) for file in files):
            raise CellError(f"{last.path}: extends '{base.stem}', which extends it in turn; take one of the two out")
        files.append(_File(base, _read(base)))
    return files


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
