"""Every room that has kernels finds them wherever there is a compiler."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

from twin_node import native_build, native_library
from twin_node.forecast import kernels as forecast
from twin_node.model import kernels as model
from twin_node.native_library import NativeLibrary, address_of, addresses_of
from twin_node.splat import library as splat

ROOMS = {
    native_build.SPLAT: splat.native_library,
    native_build.FORECAST: forecast.kernels,
    native_build.MODEL: model.kernels,
}


def test_every_room_with_kernels_is_looked_at() -> None:
    assert set(ROOMS) == set(native_build.ROOMS)


@pytest.mark.parametrize("find", ROOMS.values(), ids=[room.name for room in ROOMS])
def test_where_there_is_a_compiler_there_are_kernels(find: Callable[[], NativeLibrary | None]) -> None:
    """Else every comparison with the plain versions would be skipped, and nobody would know."""
    try:
        native_build.find_compiler()
    except native_build.CompileError as error:
        pytest.skip(str(error))
    assert find() is not None


@pytest.mark.parametrize("lies_behind_head", [False, True])
def test_addresses_are_those_of_first_entries(monkeypatch: pytest.MonkeyPatch, lies_behind_head: bool) -> None:
    if not native_library._LIES_BEHIND_HEAD and lies_behind_head:
        pytest.skip("arrays of this interpreter lie elsewhere")
    monkeypatch.setattr(native_library, "_LIES_BEHIND_HEAD", lies_behind_head)
    whole = np.arange(24, dtype=np.int32).reshape(4, 6)
    constant = np.ones(3, np.bool_)
    constant.flags.writeable = False
    for array in (
        whole,
        whole[1:, 2:],
        whole.T,
        whole[::-1],
        constant,
        np.zeros((0, 3)),
        np.frombuffer(b"abc", np.uint8),
    ):
        assert address_of(array) == array.ctypes.data
    assert addresses_of(whole, None, whole[2]) == [whole.ctypes.data, None, whole.ctypes.data + 48]
