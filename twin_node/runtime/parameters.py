"""Parameters: frozen dataclasses filled from ROS parameter files, unknown keys refused."""

from __future__ import annotations

import dataclasses
import difflib
import math
import sys
import types
import typing
from collections.abc import Mapping
from enum import Enum
from pathlib import Path
from typing import Any, TypeVar

from twin_node.errors import TwinError, kind_in_words, kind_of, told
from twin_node.yaml_file import read_yaml, yaml_text

T = TypeVar("T")

Sections = Mapping[str, Mapping[str, Any]]
"""Node name -> its `ros__parameters`; `/**` holds those of every node that knows them."""

EVERY_NODE = "/**"
"""The section whose parameters go to every node that knows them."""
LAUNCH = "launch"
"""The section of a parameter file that is not a node's: what `twin_node launch` starts."""


class ParameterError(TwinError):
    """A parameter file or a value in it is wrong."""


class _RefusedError(Exception):
    """A dataclass has refused its values; it knows no file, and not which of a list it is."""

    place = ""
    """Key after key from the outermost dataclass on, as in `.bodies[1].parts[0]`."""

    def __str__(self) -> str:
        why = super().__str__()
        return f"{self.place[1:]}: {why}" if "[" in self.place else why


def read_parameters(path: Path) -> dict[str, Mapping[str, Any]]:
    """Node name -> its `ros__parameters`, of a ROS 2 parameter file or a launch file.

    A slash before the name, as `ros2 param dump` writes it, is no part of it. Raises `ParameterError` when the file is
    not one.
    """
    content = read_yaml(path, "a parameter file (YAML)", ParameterError)
    if not isinstance(content, dict):
        raise ParameterError(f"{path}: expected 'node: {{ros__parameters: {{...}}}}', found {kind_of(content)}")
    content.pop(LAUNCH, None)
    for node, section in content.items():
        if not isinstance(section, dict) or set(section) != {"ros__parameters"}:
            raise ParameterError(f"{path}: node '{node}' must hold exactly one key, 'ros__parameters'")
        values = section["ros__parameters"]
        if not isinstance(values, dict | None):
            raise ParameterError(
                f"{path}: node '{node}': ros__parameters: expected keys and values, found {told(values)}"
            )
    sections: dict[str, Mapping[str, Any]] = {}
    for node, section in content.items():
        is_full = node != EVERY_NODE and str(node).count("/") == 1
        name = str(node).removeprefix("/") if is_full else str(node)
        if name in sections:
            raise ParameterError(f"{path}: expected each node once, found '{name}' and '/{name}'; make them one")
        sections[name] = section["ros__parameters"] or {}
    return sections


def values_of(kind: type[Any], name: str, sections: Sections) -> dict[str, Any]:
    """What sections by node name give the node of a name, whose parameters are a `kind`.

    What `/**` says is every node's that has such a key, unless its own section says otherwise, of nested keys of each.
    """
    known = {field.name for field in dataclasses.fields(kind)}
    shared = {key: value for key, value in sections.get(EVERY_NODE, {}).items() if key in known}
    return merged(shared, sections.get(name, {}))


def merged(base: Mapping[str, Any], given: Mapping[str, Any]) -> dict[str, Any]:
    """`base` with the values of `given`, key by key where both hold keys."""
    found = dict(base)
    for key, value in given.items():
        both = isinstance(value, Mapping) and isinstance(found.get(key), Mapping)
        found[key] = merged(found[key], value) if both else value
    return found


def fill(kind: type[T], values: Mapping[str, Any], where: str, default: T | None = None) -> T:
    """An instance of the dataclass `kind` with the given values in place of its defaults, or of those of `default`.

    Nested dataclasses take nested mappings; what is left out of one is as the defaults have it at that place. Lists
    become tuples. Raises `ParameterError` that names `where` and the key for an unknown key (with the nearest known
    one), a value of the wrong type, or values that the dataclass refuses.
    """
    try:
        return _fill(kind, values, where, default, ": ")
    except _RefusedError as error:
        raise ParameterError(f"{where}: {error}") from error.__cause__


def _fill(kind: type[T], values: Mapping[str, Any], where: str, default: T | None, link: str = ".") -> T:
    """As `fill`; `link` stands between `where` and a key."""
    if not isinstance(values, Mapping):
        raise ParameterError(f"{where}: expected keys and values, found {told(values)}")
    fields = {f.name: f for f in dataclasses.fields(kind)}  # type: ignore[arg-type]
    hints = typing.get_type_hints(kind)
    for name, known in fields.items():
        is_required = default is None and known.default is known.default_factory is dataclasses.MISSING
        if is_required and name not in values:
            raise ParameterError(f"{where}: expected '{name}', found none; add it")
    filled = {}
    for key, value in values.items():
        if key not in fields:
            near = difflib.get_close_matches(str(key), fields, n=1)
            hint = f"did you mean '{near[0]}'?" if near else f"known keys: {', '.join(sorted(fields))}"
            raise ParameterError(f"{where}: unknown parameter '{key}'; {hint}")
        nested = _default_of(fields[key], default) if isinstance(value, Mapping) else None
        try:
            filled[key] = _convert(hints[key], value, f"{where}{link}{key}", nested)
        except _RefusedError as error:
            error.place = f".{key}{error.place}"
            raise
    try:
        return kind(**filled) if default is None else dataclasses.replace(default, **filled)  # type: ignore[type-var]
    except TwinError as error:
        raise _RefusedError(str(error)) from error


def _default_of(field: dataclasses.Field[Any], whole: Any) -> Any:
    """A field's default, by an instance of its dataclass where there is one; None where it has none."""
    if whole is not None:
        return getattr(whole, field.name)
    if field.default_factory is not dataclasses.MISSING:
        return field.default_factory()
    return None if field.default is dataclasses.MISSING else field.default


def _convert(hint: Any, value: Any, where: str, default: Any = None) -> Any:
    """A value as a field of type `hint` takes it."""
    origin = typing.get_origin(hint)
    if origin in (types.UnionType, typing.Union):
        if value is None and type(None) in typing.get_args(hint):
            return None
        hint = next(a for a in typing.get_args(hint) if a is not type(None))
        return _convert(hint, value, where, default)
    if origin is tuple:
        return _tuple(typing.get_args(hint), value, where)
    if isinstance(hint, type) and dataclasses.is_dataclass(hint):
        return _fill(hint, value, where, default if isinstance(default, hint) else None)
    return _member(hint, value, where) if issubclass(hint, Enum) else _plain(hint, value, where)


def _tuple(hints: tuple[Any, ...], value: Any, where: str) -> tuple[Any, ...]:
    if not isinstance(value, list | tuple):
        raise ParameterError(f"{where}: expected a list, found {told(value)}")
    inner = hints[:1] * len(value) if hints[-1] is Ellipsis else hints
    if len(inner) != len(value):
        raise ParameterError(f"{where}: expected {len(inner)} values, found {len(value)}")
    return tuple(_element(a, v, where, i) for i, (a, v) in enumerate(zip(inner, value, strict=True)))


def _element(hint: Any, value: Any, where: str, index: int) -> Any:
    """A value of a list; where such are dataclasses, errors tell which."""
    if not dataclasses.is_dataclass(hint):
        return _convert(hint, value, where)
    try:
        return _convert(hint, value, f"{where}[{index}]")
    except _RefusedError as error:
        error.place = f"[{index}]{error.place}"
        raise


def _member(hint: type[Enum], value: Any, where: str) -> Enum:
    if isinstance(value, hint):
        return value
    members = {str(member.value): member for member in hint}
    if str(value) not in members:
        raise ParameterError(f"{where}: expected one of {', '.join(members)}, found {told(value)}")
    return members[str(value)]


def _plain(hint: type, value: Any, where: str) -> Any:
    """A number, a truth value or a text; a whole number will do for any."""
    is_whole = isinstance(value, int) and not isinstance(value, bool)
    if hint is float and is_whole:
        if abs(value) > sys.float_info.max:
            raise ParameterError(f"{where}: expected a number, found one beyond {sys.float_info.max:.2g}")
        return float(value)
    if not isinstance(value, hint) or (isinstance(value, bool) and hint is not bool):
        advice = f"; write {_in_yaml(value)}" if hint is float and isinstance(value, str) and _is_number(value) else ""
        raise ParameterError(f"{where}: expected {kind_in_words(hint)}, found {told(value)}{advice}")
    if isinstance(value, float) and math.isnan(value):
        raise ParameterError(f"{where}: expected a number, found nan")
    return value


def _is_number(text: str) -> bool:
    """Whether a text is a number all the same: one in quotes, or as `1e-3`, which YAML takes for text."""
    try:
        return math.isfinite(float(text))
    except ValueError:
        return False


def _in_yaml(text: str) -> str:
    """A text that is a number as YAML has that."""
    return yaml_text(float(text)).split()[0]
