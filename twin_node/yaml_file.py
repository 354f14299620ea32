"""YAML files that users write: read with one error for what cannot be, written whole or not at all."""

from __future__ import annotations

import contextlib
from pathlib import Path
from typing import Any

import yaml

from twin_node.errors import TwinError

YAML_ERRORS = (yaml.YAMLError, ValueError, RecursionError)
"""What `parse_yaml` raises: no syntax; no date, no number; no end."""


def read_yaml(path: Path, kind: str, error: type[TwinError]) -> object:
    """What a YAML file holds; `kind`: what it is expected to be, for messages.

    Raises `error` where it cannot be read, holds a value that cannot be (the 30th of February), a field twice or an
    alias within what it stands for.
    """
    try:
        return parse_yaml(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError as problem:
        raise error(f"{path}: expected {kind}, found what is no text; is it a log?") from problem
    except OSError as problem:
        raise error(f"{path}: expected {kind}, but it cannot be read: {problem.strerror}") from problem
    except YAML_ERRORS as problem:
        words = " ".join(str(problem).split()).replace('in "<unicode string>", line', "in line")
        raise error(f"{path}: expected {kind}, but it cannot be read as YAML: {words}") from problem


def parse_yaml(text: str) -> object:
    """What a text in YAML says. Raises `YAML_ERRORS` as `read_yaml` has them."""
    return yaml.load(text, _Loader)


def write_yaml(path: Path, content: object, error: type[TwinError]) -> None:
    """Writes a YAML file; what stands at `path` stays until the new one is whole.

    Raises `error` where it cannot be written.
    """
    text = yaml.dump(content, sort_keys=False, default_flow_style=None, width=120)
    partial = path.with_name(f"{path.name}.partial")
    try:
        partial.write_text(text, encoding="utf-8")
        partial.replace(path)
    except OSError as problem:
        with contextlib.suppress(OSError):
            partial.unlink(missing_ok=True)
        raise error(f"{path}: cannot be written ({problem.strerror}); give a file in a folder that exists") from None


class _Loader(yaml.SafeLoader):
    """Refuses a field that stands twice in a mapping: the last would win, and nobody would hear of it.

    Also an alias within what it stands for: that has no end, and who goes through what was read would not end either.
    """

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._open: set[str] = set()
        """Anchors of the collections that are being composed."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if self.check_event(yaml.AliasEvent):
            alias = self.peek_event()  # type: ignore[no-untyped-call]
            if alias.anchor in self._open:
                within = f"found the alias {alias.anchor!r} within what it stands for"
                raise yaml.composer.ComposerError(None, None, within, alias.start_mark)
        return super().compose_node(parent, index)

    def compose_sequence_node(self, anchor: Any) -> yaml.SequenceNode:
        self._open.add(anchor)
        node: yaml.SequenceNode = super().compose_sequence_node(anchor)
        self._open.discard(anchor)
        return node

    def compose_mapping_node(self, anchor: Any) -> yaml.MappingNode:
        self._open.add(anchor)
        node: yaml.MappingNode = super().compose_mapping_node(anchor)
        self._open.discard(anchor)
        known: set[str] = set()
        for key in (key for key, _ in node.value if isinstance(key, yaml.ScalarNode)):
            if key.value in known:
                again = f"found the field {key.value!r} a second time"
                raise yaml.constructor.ConstructorError(None, None, again, key.start_mark)
            known.add(key.value)
        return node
