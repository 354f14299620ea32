"""ROS 2 message classes and CDR, made by the rosbags typestore from the ROS 2 Jazzy set and from `msgs/msg/*.msg`."""

from __future__ import annotations

from collections.abc import Mapping
from functools import cache, cached_property
from pathlib import Path
from typing import Any, TypeAlias

from rosbags.interfaces import Nodetype
from rosbags.interfaces.typing import Constdefs, Fielddefs, Typesdict
from rosbags.serde import SerdeError
from rosbags.typesys import Stores, TypesysError, get_types_from_idl, get_types_from_msg, get_typestore
from rosbags.typesys.store import Typestore

from twin_node import resources
from twin_node.errors import TwinError
from twin_node.messages.foreign import DEFINITIONS as FOREIGN
from twin_node.messages.rows import RowCodec

Message: TypeAlias = Any
"""An instance of a class that `message_type` returned: fields as attributes, arrays as numpy arrays."""

OWN_PACKAGE = "twin_msgs"
"""ROS package that the files of `msgs/msg` belong to."""


class MessageError(TwinError):
    """A message, its type or its bytes are not what they should be."""


class DamagedError(MessageError):
    """A message's bytes do not hold what its type and its fields say: others of its topic may."""


class MessageTypes:
    """A set of message types: classes, definitions, hashes and CDR of each.

    Type names are full ROS 2 names: `sensor_msgs/msg/Image`. Raises `MessageError` for names that are not in the set.
    """

    def __init__(self, store: Typestore, fallback: MessageTypes | None = None) -> None:
        self._store = store
        self._fallback = fallback
        self._codecs: dict[str, RowCodec | None] = {}

    def __contains__(self, name: str) -> bool:
        return name in self._store.types

    def message_type(self, name: str) -> type[Message]:
        """Class of a message type; its constructor takes every field by name."""
        self._require(name)
        return self._store.types[name]

    def serialize(self, message: Message) -> memoryview:
        """CDR bytes of a message, little-endian, with the 4-byte encapsulation header (OMG DDSI-RTPS 10.2)."""
        name = message.__msgtype__
        codec = self.row_codec(name)
        packed = None if codec is None else codec.pack(message)
        return packed if packed is not None else self._store.serialize_cdr(message, name, little_endian=True)

    def deserialize(self, data: bytes | memoryview, name: str) -> Message:
        """Message from CDR bytes; array fields are read-only numpy views of `data`, nothing is copied.

        A sequence of flat structs behind a header is such a view too: `rows.Rows`.

        Where a definition given to `extended` does not fit, that of the set that it extends is tried: some recorders
        store placeholders. Raises `MessageError` if `data` is not a message of that type.
        """
        codec = self.row_codec(name)
        try:
            message = None if codec is None else codec.unpack(memoryview(data))
            return message if message is not None else self._store.deserialize_cdr(memoryview(data), name)
        except (SerdeError, IndexError, TypeError, OverflowError) as error:
            if self._fallback is not None and name in self._fallback:
                return self._fallback.deserialize(data, name)
            raise MessageError(
                f"{name}: {len(data)} bytes are not a CDR message of this type ({error}); "
                "the sender's definition differs or the data are damaged"
            ) from None

    def row_codec(self, name: str) -> RowCodec | None:
        """How the structs of a message type are an array; None for types of another make."""
        self._require(name)
        if name not in self._codecs:
            self._codecs[name] = RowCodec.of(self._store, name)
        return self._codecs[name]

    def definition(self, name: str) -> str:
        """Definition in the `ros2msg` form: the type's own text, then those of the types that it uses."""
        self._require(name)
        return self._store.generate_msgdef(name, ros_version=2)[0]

    def type_hash(self, name: str) -> str:
        """RIHS01 hash of the type, as ROS 2 announces it (REP-2016)."""
        self._require(name)
        return self._as_idl.hash_rihs01(name)

    @cached_property
    def _as_idl(self) -> Typestore:
        """The types' fields as rosidl makes IDL of them, which hashes are of: a `char` is a `uint8` there."""
        fields = Typestore()
        for name, (constants, members) in self._store.fielddefs.items():
            fields.fielddefs[name] = (constants, [(member, _idl_field(kind)) for member, kind in members])
        return fields

    def with_types(self, types: Typesdict) -> MessageTypes:
        """This set and types of names that it does not have, whose fields are all of known types."""
        store = _copy(self._store)
        store.register(types)
        return MessageTypes(store)

    def extended(self, definitions: Mapping[str, str]) -> MessageTypes:
        """This set and the types of `definitions` (name to `ros2msg` or IDL text), which win over equal names here.

        A definition that cannot be parsed, that uses types that are nowhere defined or itself, or that has a name twice
        is left out: its type is then unknown unless it is in this set. Where nothing is added this set itself is
        returned, with what it has compiled.
        """
        store = self._store
        for name, text in definitions.items():
            if name in self and text == self.definition(name):
                continue
            tried = _copy(store)
            try:
                parsed = _parse(name, text)
                if not _complete(tried, parsed):
                    continue
                _replace(tried, parsed)
                for one in parsed:
                    tried.hash_rihs01(one)
            except (TypesysError, KeyError, IndexError, ValueError, SyntaxError, RecursionError):
                continue
            store = tried
        return self if store is self._store else MessageTypes(store, fallback=self)

    def _require(self, name: str) -> None:
        if name not in self._store.types:
            raise MessageError(
                f"{name}: unknown message type; expected a name like sensor_msgs/msg/Image from the ROS 2 Jazzy set or "
                f"{OWN_PACKAGE}; add its definition to msgs/msg or check the spelling"
            )


def _copy(store: Typestore) -> Typestore:
    copied = Typestore()
    copied.fielddefs.update(store.fielddefs)
    copied.types.update(store.types)
    return copied


def _idl_field(field: Any) -> Any:
    node, inside = field
    if node in (Nodetype.ARRAY, Nodetype.SEQUENCE):
        return node, (_idl_field(inside[0]), inside[1])
    return (node, ("uint8", 0)) if node == Nodetype.BASE and inside[0] == "char" else field


def _parse(name: str, text: str) -> Typesdict:
    separator = "=" * 80 + "\n"
    if text.startswith(f"{separator}IDL: "):
        parsed: Typesdict = {}
        for section in text.split(separator)[1:]:
            parsed.update(get_types_from_idl(section.split("\n", 1)[1]))
        return parsed
    return get_types_from_msg(text, name)


def _used(parsed: tuple[Constdefs, Fielddefs]) -> set[str]:
    """Names of the types that a parsed definition has fields or arrays of."""
    elements = [field[1][0] if field[0] in (Nodetype.ARRAY, Nodetype.SEQUENCE) else field for _, field in parsed[1]]
    return {str(element[1]) for element in elements if element[0] == Nodetype.NAME}


def _complete(store: Typestore, parsed: Typesdict) -> bool:
    """Whether every type that the parsed ones use is among them or known."""
    used = {name for one in parsed.values() for name in _used(one)}
    return all(name in parsed or name in store.fielddefs for name in used)


def _replace(store: Typestore, parsed: Typesdict) -> None:
    """Registers types and drops those of the same name whose fields differ."""
    for name, (_, fields) in parsed.items():
        known = store.fielddefs.get(name)
        if known is not None and [(n.lower(), d) for n, d in known[1]] != [(n.lower(), d) for n, d in fields]:
            del store.fielddefs[name], store.types[name]
    new = {name: one for name, one in parsed.items() if name not in store.fielddefs}
    if new:
        store.register(new)


@cache
def builtin_types() -> MessageTypes:
    """The ROS 2 Jazzy set and `twin_msgs`, read once from `msgs/msg/*.msg`."""
    folders = [root / "msgs" / "msg" for root in resources.roots()]
    folder = next((folder for folder in folders if folder.is_dir()), None)
    return read_types(folder or resources.find("msgs/msg"))


def read_types(folder: Path) -> MessageTypes:
    """The ROS 2 Jazzy set, `foreign.DEFINITIONS` and, as package `twin_msgs`, the types of a folder of `.msg` files.

    Raises `MessageError` naming the file that is no message definition or uses a type that is nowhere defined.
    """
    store = get_typestore(Stores.ROS2_JAZZY)
    for name, text in FOREIGN.items():
        store.register(get_types_from_msg(text, name))
    own: Typesdict = {}
    for path in sorted(folder.glob("*.msg")):
        try:
            own.update(get_types_from_msg(path.read_text(encoding="utf-8"), f"{OWN_PACKAGE}/msg/{path.stem}"))
        except (TypesysError, ValueError) as error:
            reason = " ".join(str(error).split())
            raise MessageError(f"{path}: not a ROS 2 message definition ({reason}); correct the file") from None
    for name, parsed in own.items():
        if undefined := sorted(_used(parsed) - own.keys() - store.fielddefs.keys()):
            raise MessageError(f"{name}: uses {', '.join(undefined)}, defined nowhere; correct {folder}")
    store.register(own)
    return MessageTypes(store)


def message_type(name: str) -> type[Message]:
    """Class of a message type of the built-in set (`sensor_msgs/msg/Image`); raises `MessageError` if unknown."""
    return builtin_types().message_type(name)


def serialize(message: Message) -> memoryview:
    """CDR bytes of a message of the built-in set, with encapsulation header."""
    return builtin_types().serialize(message)


def deserialize(data: bytes | memoryview, name: str) -> Message:
    """Message of the built-in set from CDR bytes; arrays are read-only views of `data`. Raises `MessageError`."""
    return builtin_types().deserialize(data, name)


def definition(name: str) -> str:
    """`ros2msg` definition of a type of the built-in set, with all types that it uses."""
    return builtin_types().definition(name)


def type_hash(name: str) -> str:
    """RIHS01 hash of a type of the built-in set."""
    return builtin_types().type_hash(name)
