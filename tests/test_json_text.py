"""Figures as JSON: what is not known is null, and everybody can read it."""

from __future__ import annotations

import json
import math

import numpy as np

from twin_node.json_text import json_text


def test_what_is_not_known_is_null() -> None:
    figures = {"a": math.nan, "b": [1.5, -math.inf, (math.inf,)], "c": {"d": np.float64("nan"), "e": np.float64(2)}}
    assert json.loads(json_text(figures)) == {"a": None, "b": [1.5, None, [None]], "c": {"d": None, "e": 2.0}}
    assert json_text({"a": 1}, 2) == '{\n  "a": 1\n}'
