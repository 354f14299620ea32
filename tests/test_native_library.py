"""Every room that has kernels finds them wherever there is a compiler."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from twin_node import native_build
from twin_node.forecast import kernels as forecast
from twin_node.model import kernels as model
from twin_node.native_library import NativeLibrary
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
