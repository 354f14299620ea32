"""Whether tensors have been written to, so that what is found of them need be sought no oftener."""

from __future__ import annotations

from typing import Any

from torch import Tensor


class Writes:
    """Keeps watch over some tensors, always the same."""

    def __init__(self) -> None:
        self._versions: tuple[int, ...] = ()

    def __getstate__(self) -> dict[str, Any]:
        """Tensors of a copy count their writes from the start again: by chance, as many as these had when last seen."""
        return {"_versions": ()}

    def have_come(self, *tensors: Tensor) -> bool:
        """Whether any of `tensors` has been written to since this was asked last; true when it is asked first."""
        versions = tuple(tensor._version for tensor in tensors)
        if versions == self._versions:
            return False
        self._versions = versions
        return True
