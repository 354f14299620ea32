"""Figures as JSON that every reader takes."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any


def json_text(figures: Mapping[str, object], indent: int | None = None) -> str:
    """One JSON object, with null for what is not `known`."""
    return json.dumps(known(figures), indent=indent, allow_nan=False)


def known(figures: Mapping[str, object]) -> dict[str, Any]:
    """The figures with None for NaN and infinities, however deep: JSON knows neither. Tuples become lists."""
    return {name: _known(value) for name, value in figures.items()}


def _known(value: Any) -> Any:
    if isinstance(value, Mapping):
        return known(value)
    if isinstance(value, list | tuple):
        return [_known(inner) for inner in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value
