"""What benches call the forecasts that they compare."""

from __future__ import annotations

from dataclasses import fields

from twin_node.forecast import Baselines

OURS = "ours"
BASELINES = tuple(field.name for field in fields(Baselines))
"""Forecasts of the same evidence, in the order of tables."""
