"""Parameters of the window model: what means nothing is refused by name, what switches a part off is not."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest

from twin_node.model import (
    BirthParameters,
    MapParameters,
    ModelError,
    ModelParameters,
    SeedParameters,
    TrackParameters,
    WindowModel,
)

WRONG = [
    (ModelParameters, "model: gaussians_per_pixel", (0.0, -1.0, math.inf, math.nan, 1e6)),
    (ModelParameters, "model: most_gaussians", (0, -1, 10**12)),
    (ModelParameters, "model: nodes", (0, -1, 10**9)),
    (ModelParameters, "model: window", (-3, 0, 1, 10**9)),
    (SeedParameters, "model: seed.steps", (-1, 10**9)),
    (SeedParameters, "model: seed.stride_px", (0, -1, 10**9)),
    (SeedParameters, "model: seed.levels", (0, -1, 2, 10**9)),
    (SeedParameters, "model: seed.shell_factor", (0.0, -1.0, math.inf)),
    (TrackParameters, "model: track.alignments", (-1, 10**9)),
    (TrackParameters, "model: track.steps", (-1, 10**9)),
    (TrackParameters, "model: track.learning_rate", (0.0, -1.0, math.inf)),
    (TrackParameters, "model: track.velocity_damping", (-1.0, 5.0, math.nan)),
    (BirthParameters, "model: birth.per_set", (-1, 10**9)),
    (BirthParameters, "model: birth.moving_share", (-1.0, 3.0)),
    (BirthParameters, "model: birth.node_members", (0, -1)),
    (BirthParameters, "model: birth.transient_s", (-1.0, math.inf)),
    (BirthParameters, "model: birth.stale_s", (-1.0, math.inf)),
    (MapParameters, "model: map.steps", (-1, 10**9)),
    (MapParameters, "model: map.tries", (-1, 10**9)),
    (MapParameters, "model: map.calm_s", (-1.0, math.inf)),
    (MapParameters, "model: map.patience_s", (-1.0, math.inf)),
    (MapParameters, "model: map.most_born", (-1, 10**9)),
]


@pytest.mark.parametrize(("kind", "key", "values"), WRONG)
def test_numbers_that_mean_nothing_are_refused_by_name(kind: Any, key: str, values: tuple[float, ...]) -> None:
    for value in values:
        with pytest.raises(ModelError, match=re.escape(f"{key}: expected ") + f".*, found {value:.15g};"):
            kind(**{key.rpartition(" ")[2].rpartition(".")[2]: value})


def test_a_part_may_be_switched_off() -> None:
    SeedParameters(steps=0)
    TrackParameters(alignments=0, steps=0, velocity_damping=0.0)
    BirthParameters(per_set=0, moving_share=0.0, transient_s=0.0, stale_s=0.0, node_members=10**6)
    MapParameters(steps=0, tries=0, calm_s=0.0, patience_s=0.0, most_born=0)
    ModelParameters(gaussians_per_pixel=10.0, most_gaussians=1, nodes=1, window=2)


@pytest.mark.parametrize("device", ["banana", "cuda:99", "meta", "hpu", ""])
def test_a_device_that_is_not_there_is_refused_by_name(device: str) -> None:
    with pytest.raises(ModelError, match=f"device: expected cpu or a CUDA device that is there, found '{device}'"):
        WindowModel(ModelParameters(device=device))
