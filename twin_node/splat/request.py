"""Structs of the compiled library, filled by the names of their fields, and its errors by those of the arguments."""

from __future__ import annotations

import ctypes
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from typing import Any, TypeVar

from torch import Tensor

from twin_node.splat import library as native
from twin_node.splat.arguments import Options, non_finite
from twin_node.splat.semantics import Semantics, installed_semantics

DEPTH_MODES = {"RGB": 0, "D": 1, "RGB+D": 1, "ED": 2, "RGB+ED": 2}
"""`splat::DepthMode` of each render mode."""

Struct = TypeVar("Struct", bound=ctypes.Structure)
Field = int | float | Tensor | ctypes.Structure | None


def fill(struct: type[Struct], /, **fields: Field) -> Struct:
    """A struct of the library; a tensor stands for where it begins, an empty one for none; what is not named is 0.

    The struct is good for as long as the tensors are held. Raises `AttributeError` for a name that is no field's.
    """
    return struct(**_addressed(fields))


def new_request(options: Options, semantics: Semantics | None = None, /, **fields: Field) -> native.Request:
    """What is drawn how, by `options` and `semantics` (default: those of the installed gsplat), and by other fields.

    Good for as long as the tensors are held. Raises `AttributeError` for a name that is no field's.
    """
    semantics = semantics or installed_semantics()
    return native.Request(
        near_plane=options.near_plane,
        far_plane=options.far_plane,
        radius_clip=options.radius_clip,
        eps2d=options.eps2d,
        sh_degree=options.sh_degree or 0,
        depth_mode=DEPTH_MODES[options.render_mode],
        antialiased=int(options.rasterize_mode == "antialiased"),
        max_alpha=semantics.max_alpha,
        min_compensation=semantics.min_compensation,
        **_addressed(fields),
    )


@contextmanager
def not_finite_is_named(given: Mapping[str, Tensor | None]) -> Iterator[None]:
    """Raises `ValueError` naming the argument that a call of the library finds not to be finite.

    `given`: its arguments in the order in which the library counts those that it checks.
    """
    try:
        yield
    except native.NonFiniteError as error:
        name, tensor = list(given.items())[error.index]
        assert tensor is not None
        raise non_finite(name, tensor) from None


def _addressed(fields: dict[str, Field]) -> dict[str, Any]:
    return {
        name: (value.data_ptr() if value.numel() else None) if isinstance(value, Tensor) else value
        for name, value in fields.items()
    }
