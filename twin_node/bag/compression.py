"""Bags that rosbag2 has compressed with zstd: whole files, or message by message."""

from __future__ import annotations

import contextlib
import tempfile
from collections.abc import Collection, Iterator, Mapping
from dataclasses import replace
from enum import Enum
from pathlib import Path
from typing import Any

from zstandard import ZstdDecompressor, ZstdError

from twin_node.bag.log import BagError, Channel, DamageError, Part, Record, Storage


class Compression(Enum):
    """What is compressed, as `metadata.yaml` says in `compression_mode`."""

    NONE = "NONE"
    FILE = "FILE"
    MESSAGE = "MESSAGE"

    @staticmethod
    def of(information: Mapping[str, Any], file: Path) -> Compression:
        """Of the content of a `metadata.yaml`; raises `BagError` for a compressor other than zstd."""
        mode = str(information.get("compression_mode") or "NONE").upper()
        form = str(information.get("compression_format") or "")
        if mode not in Compression.__members__:
            raise BagError(f"{file}: compression_mode '{mode}'; expected NONE, FILE or MESSAGE")
        compression = Compression[mode]
        if compression is not Compression.NONE and form != "zstd":
            raise BagError(f"{file}: compressed with '{form}'; expected zstd; convert it with `ros2 bag convert`")
        return compression


MAGIC = b"\x28\xb5\x2f\xfd"
"""What a file that zstd has compressed begins with."""


def plain_name(name: str) -> str:
    """Name of a file before it was compressed."""
    return name.removesuffix(".zstd").removesuffix(".zst")


@contextlib.contextmanager
def unpacked(path: Path, compression: Compression) -> Iterator[Path]:
    """Path of the file as storages read it; of a compressed one, a copy that goes when it has been opened.

    Whether it is compressed its first bytes tell, too: of a recorder that was killed no metadata do. Raises `BagError`
    where it cannot be decompressed, or the copy cannot be written; `OSError` as `open` does.
    """
    with path.open("rb") as file:
        is_packed = compression is Compression.FILE or file.read(len(MAGIC)) == MAGIC
    if not is_packed:
        yield path
        return
    with tempfile.TemporaryDirectory(prefix="twin_node_") as folder:
        plain = Path(folder) / plain_name(path.name)
        with path.open("rb") as packed:
            try:
                with plain.open("wb") as out:
                    ZstdDecompressor().copy_stream(packed, out)
            except ZstdError as error:
                raise BagError(f"{path}: cannot be decompressed ({error}); copy the bag again") from None
            except OSError as error:
                raise BagError(
                    f"{path}: cannot be decompressed into {tempfile.gettempdir()} ({error.strerror}); free space "
                    "there, or set TMPDIR to a folder that has it"
                ) from None
        if not plain.stat().st_size:
            raise BagError(f"{path}: cannot be decompressed (it is empty or cut short); copy the bag again")
        yield plain


class UnpackedMessages:
    """A storage whose messages are compressed one by one."""

    def __init__(self, path: Path, storage: Storage) -> None:
        self._path = path
        self._storage = storage
        self._decompressor = ZstdDecompressor()

    @property
    def channels(self) -> tuple[Channel, ...]:
        """What the file holds."""
        return self._storage.channels

    @property
    def definitions(self) -> Mapping[str, str]:
        """Message definitions that the file carries."""
        return self._storage.definitions

    @property
    def metadata(self) -> Mapping[str, Mapping[str, str]]:
        """Metadata records by name."""
        return self._storage.metadata

    @property
    def attachments(self) -> tuple[str, ...]:
        """Names of the files beside the messages."""
        return self._storage.attachments

    @property
    def parts(self) -> tuple[Part, ...]:
        """The file's parts, which this storage reads."""
        return tuple(replace(part, storage=self) for part in self._storage.parts)

    @property
    def damage(self) -> str | None:
        """One line about where the file ends too early."""
        return self._storage.damage

    def records(self, part: Part, topics: Collection[str] | None, start: int, stop: int) -> Iterator[Record]:
        """Messages of a part, decompressed; raises `DamageError` where one cannot be."""
        for record in self._storage.records(part, topics, start, stop):
            try:
                yield replace(record, data=self._decompressor.decompress(record.data))
            except (ZstdError, MemoryError) as error:  # its head says how much memory it wants
                why = str(error) or "it says that it is larger than all memory"
                raise DamageError(
                    f"{self._path}: message on {record.topic} at {record.stamp} ns cannot be decompressed ({why}); "
                    "read up to it"
                ) from None

    def close(self) -> None:
        """Releases the file."""
        self._storage.close()
