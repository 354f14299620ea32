"""What a launch file lets the user set, and where its values go."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from twin_node.errors import kind_in_words, told
from twin_node.nodes.launch.kinds import CHAIN_SECTIONS, nearest
from twin_node.nodes.topics import GraphError
from twin_node.runtime.parameters import LAUNCH, read_parameters
from twin_node.yaml_file import YAML_ERRORS, parse_yaml, read_yaml

VARIABLE = re.compile(r"\$\(var ([A-Za-z_]\w*)\)")
"""A value that the user gives, as in the YAML launch files of ROS 2."""


@dataclass(frozen=True)
class Argument:
    """What a launch file lets the user set."""

    name: str
    help: str = ""
    default: Any = None
    is_required: bool = False
    choices: tuple[str, ...] = ()
    """Its values; empty: any."""

    @property
    def told(self) -> str:
        """What it is for, and its values where these are a few."""
        return f"{self.help} [{', '.join(self.choices)}]" if self.choices else self.help


def launch_section(path: Path) -> dict[str, Any]:
    """The section `launch` of a launch file. Raises `GraphError` where it is none."""
    return _section_in(read_yaml(path, "a launch file (YAML)", GraphError), path)


def _section_in(content: Any, path: Path) -> dict[str, Any]:
    if not isinstance(content, dict) or LAUNCH not in content:
        raise GraphError(f"{path}: has no section '{LAUNCH}'; give a launch file, for example launch/replay.yaml")
    section = content[LAUNCH]
    if not isinstance(section, dict):
        raise GraphError(f"{path}: {LAUNCH}: expected keys and values, found {told(section)}")
    known = {"arguments", "processes", "use_sim_time", "lockstep", "zenoh"}
    for key in section:
        if key not in known:
            raise GraphError(f"{path}: {LAUNCH}: unknown key '{key}'; {nearest(str(key), known)}")
    return section


def table_of(section: Mapping[str, Any], key: str, path: Path) -> dict[str, Any]:
    """A part of the launch section that holds keys and values; empty where it is left out.

    Raises `GraphError` for anything else.
    """
    value = section.get(key)
    if not isinstance(value, dict | None):
        raise GraphError(f"{path}: {LAUNCH}: {key}: expected keys and values, found {told(value)}")
    return value or {}


def arguments_of(section: Mapping[str, Any], path: Path) -> tuple[Argument, ...]:
    """Those of a launch section. Raises `GraphError` for what is none."""
    found = []
    for name, given in table_of(section, "arguments", path).items():
        entry = given or {}
        if not isinstance(entry, dict) or set(entry) - {"default", "help", "choices"}:
            raise GraphError(f"{path}: argument '{name}': expected 'default', 'help' and 'choices', found {entry!r}")
        is_required = "default" not in entry
        choices = _choices(entry.get("choices", []), f"{path}: argument '{name}'")
        argument = Argument(str(name), str(entry.get("help", "")), entry.get("default"), is_required, choices)
        if choices and not is_required:
            _check_choice(argument, argument.default, f"{path}: argument '{name}': default")
        found.append(argument)
    return tuple(found)


def _choices(given: Any, where: str) -> tuple[str, ...]:
    if not isinstance(given, list) or not all(isinstance(choice, str) for choice in given):
        raise GraphError(f"{where}: choices: expected a list of texts, found {told(given)}")
    return tuple(given)


def _check_choice(argument: Argument, value: Any, where: str) -> None:
    if argument.choices and value not in argument.choices:
        raise GraphError(f"{where}: expected one of {', '.join(argument.choices)}, found {told(value)}")


def values_given(arguments: Sequence[Argument], given: Sequence[str], path: Path) -> dict[str, Any]:
    """The value of each argument, `name:=value` for those given. Raises `GraphError` for unknown and missing ones."""
    known = {argument.name: argument for argument in arguments}
    texts: dict[str, str] = {}
    for text in given:
        name, separator, value = text.partition(":=")
        if not separator:
            raise GraphError(f"{text}: expected NAME:=VALUE, for example log:=run.mcap")
        if name not in known:
            raise GraphError(f"{path}: unknown argument '{name}'; {nearest(name, set(known))}")
        texts[name] = value
    missing = [name for name, argument in known.items() if argument.is_required and name not in texts]
    if missing:
        hints = "; ".join(f"{name}: {known[name].told}" for name in missing)
        raise GraphError(f"{path}: needs {' and '.join(f'{name}:=VALUE' for name in missing)} ({hints})")
    return _filled(arguments, texts, path)


def _filled(arguments: Sequence[Argument], texts: Mapping[str, str], path: Path) -> dict[str, Any]:
    """The value of each argument: as given in `texts`, else its default, which those before it may be in; one that is
    required and not given stands for itself."""
    values: dict[str, Any] = {}
    for argument in arguments:
        name, where = argument.name, f"{path}: argument '{argument.name}': default"
        default = f"$(var {name})" if argument.is_required else substituted(argument.default, values, where)
        values[name] = _typed(replace(argument, default=default), texts[name], path) if name in texts else default
    return values


def _typed(argument: Argument, text: str, path: Path) -> Any:
    """A value of the type of the argument's default; text where it has none."""
    _check_choice(argument, text, f"{path}: argument {argument.name}")
    kind = type(argument.default)
    if kind in (str, type(None)):
        return with_home(text)
    value = parsed(text, f"{path}: argument {argument.name}:={text}: expected {kind_in_words(kind)}")
    if kind is float:
        value = _as_float(value)
    if type(value) is not kind:
        raise GraphError(f"{path}: argument {argument.name}:={text}: expected {kind_in_words(kind)}")
    return value


def with_home(value: Any) -> Any:
    """A path below the user's home folder as a whole one, for no shell fills it in after `:=`; all else as it is."""
    return str(Path(value).expanduser()) if isinstance(value, str) and value.startswith("~/") else value


def _as_float(value: Any) -> Any:
    """A number that YAML takes for a whole one, or for text (`1e-3`), as one with a fraction; all else as it is."""
    if isinstance(value, bool) or not isinstance(value, int | str):
        return value
    try:
        number = float(value)
    except (ValueError, OverflowError):
        return value
    return number if math.isfinite(number) else value


def parsed(text: str, expected: str) -> Any:
    """A value as YAML has it; `expected` begins the error for one that is none."""
    try:
        return parse_yaml(text)
    except YAML_ERRORS:
        raise GraphError(f"{expected}, found what is no YAML; quote it") from None


def parameters_alone(path: Path) -> dict[str, Mapping[str, Any]]:
    """Node name -> its parameters, of a parameter file, or of a launch file that nothing is given to: its arguments
    are as they are by default.

    Raises `ParameterError` where the file is neither, and `GraphError` for a parameter of the chain that hangs on an
    argument without a default.
    """
    sections = read_parameters(path)
    content = read_yaml(path, "a parameter file (YAML)", GraphError)
    if not isinstance(content, Mapping) or LAUNCH not in content:
        return sections
    arguments = arguments_of(_section_in(content, path), path)
    filled: dict[str, Mapping[str, Any]] = substituted(sections, _filled(arguments, {}, path), path)
    _check_complete({name: filled[name] for name in CHAIN_SECTIONS if name in filled}, str(path))
    return filled


def _check_complete(value: Any, where: str) -> None:
    """Raises `GraphError` for a value that waits for an argument."""
    if isinstance(value, Mapping):
        for key, inner in value.items():
            _check_complete(inner, f"{where}: {key}")
    elif isinstance(value, list):
        for inner in value:
            _check_complete(inner, where)
    elif isinstance(value, str) and (waits := VARIABLE.search(value)):
        raise GraphError(
            f"{where}: the argument '{waits[1]}' has no default, and only a launch is given one; write the value into "
            "a parameter file"
        )


def substituted(value: Any, values: Mapping[str, Any], path: Path | str) -> Any:
    """What a file says with the values of its arguments in it. Raises `GraphError` for an argument that it has not.

    `path`: what errors name.
    """
    if isinstance(value, dict):
        return {key: substituted(inner, values, path) for key, inner in value.items()}
    if isinstance(value, list):
        return [substituted(inner, values, path) for inner in value]
    if not isinstance(value, str):
        return value
    whole = VARIABLE.fullmatch(value)
    if whole:
        return _value_of(whole, values, path)
    return VARIABLE.sub(lambda match: str(_value_of(match, values, path)), value)


def _value_of(match: re.Match[str], values: Mapping[str, Any], path: Path | str) -> Any:
    if match[1] not in values:
        raise GraphError(f"{path}: $(var {match[1]}): no such argument; {nearest(match[1], set(values))}")
    return values[match[1]]
