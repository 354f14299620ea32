"""YAML files that users write: read with one error for what cannot be, written whole or not at all."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import yaml

from twin_node.errors import TwinError, reason, repeated
from twin_node.unfinished import whole_file

YAML_ERRORS = (yaml.YAMLError, ValueError, RecursionError)
"""What `parse_yaml` raises: no syntax; no date, no number; no end."""
LARGEST = 10**4000
"""Whole numbers beyond this cannot be: written in hexadecimal they may be longer than Python prints in decimal."""
MOST_REPEATED = 1_000_000
"""Characters that the aliases of a file may stand for, all together: a rig of a hundred cameras has a tenth of it."""


def read_yaml(path: Path, kind: str, error: type[TwinError]) -> object:
    """What a YAML file holds; `kind`: what it is expected to be, for messages.

    Raises `error` where it cannot be read, holds a value that cannot be (the 30th of February), a field twice, an
    alias within what it stands for, or aliases that stand for more than `MOST_REPEATED`.
    """
    try:
        return parse_yaml(path.read_text(encoding="utf-8"))
    except UnicodeDecodeError as problem:
        raise error(f"{path}: expected {kind}, found what is no text; is it a log?") from problem
    except OSError as problem:
        raise error(f"{path}: expected {kind}, but it cannot be read: {problem.strerror}") from problem
    except YAML_ERRORS as problem:
        raise error(f"{path}: expected {kind}, but it cannot be read as YAML: {yaml_reason(problem)}") from problem


def yaml_reason(problem: Exception) -> str:
    """Which of `YAML_ERRORS` it was, in one line, without the words of those who program."""
    words = reason(problem).replace('in "<unicode string>", line', "in line")
    return words.replace("unhashable key", "a list or a mapping as a key")


def parse_yaml(text: str, texts_of: str | None = None) -> object:
    """What a text in YAML says. Raises `YAML_ERRORS` as `read_yaml` has them.

    `texts_of`: a field whose own fields are text as it stands, but null: others write `run: 007` and mean that.
    """
    loader = _Loader(text)
    loader.texts_of = texts_of
    try:
        return loader.get_single_data()
    finally:
        loader.dispose()


def yaml_text(content: object) -> str:
    """Content as YAML, in its own order; numbers of NumPy as such of Python."""
    return yaml.dump(content, Dumper=_Dumper, sort_keys=False, default_flow_style=None, width=120)


def write_yaml(path: Path, content: object, error: type[TwinError]) -> None:
    """Writes a YAML file; what stands at `path` stays until the new one is whole.

    Raises `error` where it cannot be written.
    """
    with whole_file(path, error) as partial:
        partial.write_text(yaml_text(content), encoding="utf-8")


class _Dumper(yaml.SafeDumper):
    """Writes nothing that `parse_yaml` does not read: PyYAML's own writes a number of NumPy as an object of Python."""

    def represent_data(self, data: Any) -> yaml.Node:
        node: yaml.Node = super().represent_data(data.item() if isinstance(data, np.generic) else data)
        return node


class _Loader(yaml.SafeLoader):
    """Refuses a field that stands twice in a mapping: the last would win, and nobody would hear of it.

    Also an alias within what it stands for: that has no end, and who goes through what was read would not end either.
    Nor, in any time that one would wait, where aliases of aliases multiply. A value that is not what its tag says
    (`!!bool maybe`) is an error like others: PyYAML lets out what its code trips over.
    """

    def __init__(self, stream: str) -> None:
        super().__init__(stream)
        self._open: set[str] = set()
        """Anchors of the collections that are being composed."""
        self._sizes: dict[yaml.Node, int] = {}
        """Characters of each node, with all that its aliases stand for; of a collection one more."""
        self._repeated = 0
        self.texts_of: str | None = None
        """See `parse_yaml`."""

    def compose_node(self, parent: yaml.Node | None, index: Any) -> yaml.Node | None:
        if not self.check_event(yaml.AliasEvent):
            return super().compose_node(parent, index)
        alias = self.peek_event()  # type: ignore[no-untyped-call]
        if alias.anchor in self._open:
            within = f"found the alias {alias.anchor!r} within what it stands for"
            raise yaml.composer.ComposerError(None, None, within, alias.start_mark)
        node = super().compose_node(parent, index)
        self._repeated += 0 if node is None else self._sizes[node]
        if self._repeated > MOST_REPEATED:
            many = f"found aliases that stand for more than {MOST_REPEATED} characters, {alias.anchor!r} among them"
            raise yaml.composer.ComposerError(None, None, many, alias.start_mark)
        return node

    def construct_object(self, node: yaml.Node, deep: bool = False) -> Any:
        try:
            value = super().construct_object(node, deep)
            if isinstance(value, int) and abs(value) > LARGEST:
                raise OverflowError
            return value
        except (LookupError, AttributeError, OverflowError):
            kind = node.tag.rpartition(":")[2]
            wrong = f"expected what can be !!{kind}, found {repeated(node.value)}"
            raise yaml.constructor.ConstructorError(None, None, wrong, node.start_mark) from None

    def compose_scalar_node(self, anchor: Any) -> yaml.ScalarNode:
        node: yaml.ScalarNode = super().compose_scalar_node(anchor)
        self._sizes[node] = 1 + len(node.value)
        return node

    def compose_sequence_node(self, anchor: Any) -> yaml.SequenceNode:
        self._open.add(anchor)
        node: yaml.SequenceNode = super().compose_sequence_node(anchor)
        self._open.discard(anchor)
        self._sizes[node] = 1 + sum(self._sizes[inner] for inner in node.value)
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
        for key, value in node.value:
            if isinstance(value, yaml.MappingNode) and key.value == self.texts_of:
                _take_as_text(value)
        self._sizes[node] = 1 + sum(self._sizes[key] + self._sizes[value] for key, value in node.value)
        return node


def _take_as_text(mapping: yaml.MappingNode) -> None:
    for node in (one for pair in mapping.value for one in pair if isinstance(one, yaml.ScalarNode)):
        if node.tag != "tag:yaml.org,2002:null":
            node.tag = "tag:yaml.org,2002:str"
