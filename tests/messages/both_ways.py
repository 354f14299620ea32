"""Records through messages and back."""

from __future__ import annotations

from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from twin_node.messages import Message, deserialize, serialize

STAMP = 1_700_000_000_123_456_789


def sent(message: Message) -> Message:
    return deserialize(bytes(serialize(message)), message.__msgtype__)


def assert_same(found: Any, expected: Any) -> None:
    if is_dataclass(expected):
        for item in fields(expected):
            assert_same(getattr(found, item.name), getattr(expected, item.name))
    elif isinstance(expected, tuple) and expected and is_dataclass(expected[0]):
        assert len(found) == len(expected)
        for pair in zip(found, expected, strict=True):
            assert_same(*pair)
    elif isinstance(expected, np.ndarray):
        assert found.dtype == expected.dtype
        np.testing.assert_array_equal(found, expected)
    else:
        assert found == expected
