"""Parameters of the forecast: what means nothing is refused by name, what switches a part off is not."""

from __future__ import annotations

import math
import re
from typing import Any

import pytest

from twin_node.forecast import CoverParameters, ForecastError
from twin_node.forecast.bound import BoundParameters
from twin_node.forecast.sights import CarvingParameters
from twin_node.forecast.static import StaticParameters

WRONG = [
    (CarvingParameters, "forecast: carving.sigmas", (-1.0, 1000.0, math.inf)),
    (CarvingParameters, "forecast: carving.assumed_sigma_m", (-1.0, 3.0, math.inf)),
    (CarvingParameters, "forecast: carving.depth_margin", (-1.0, 15.0, math.inf)),
    (CarvingParameters, "forecast: carving.depth_share", (-1.0, 1.5)),
    (CarvingParameters, "forecast: carving.thickness", (0.0, -1.0, 300.0, math.inf)),
    (CarvingParameters, "forecast: carving.thickness_share", (0.0, -1.0, math.inf)),
    (StaticParameters, "forecast: static.opacity", (-1.0, 2.0)),
    (StaticParameters, "forecast: static.period_ns", (-1,)),
    (BoundParameters, "forecast: bound.coverage", (0.0, 1.0, 99.0, -1.0)),
    (BoundParameters, "forecast: bound.acceleration", (-1.0, math.inf)),
    (BoundParameters, "forecast: bound.correction", (-1.0, math.inf)),
    (BoundParameters, "forecast: bound.follow", (-1.0, math.inf)),
    (BoundParameters, "forecast: bound.surprise", (-1.0, math.inf)),
    (CoverParameters, "obstacles: most_moving", (0, -1, 10**9)),
    (CoverParameters, "obstacles: most_static", (0, -1, 10**9)),
    (CoverParameters, "obstacles: most_unknown", (0, -1, 10**9)),
    (CoverParameters, "obstacles: unknown_share", (0.0, -1.0, 1.5)),
]


@pytest.mark.parametrize(("kind", "key", "values"), WRONG)
def test_numbers_that_mean_nothing_are_refused_by_name(kind: Any, key: str, values: tuple[float, ...]) -> None:
    for value in values:
        with pytest.raises(ForecastError, match=re.escape(f"{key}: expected ") + f".*, found {value:.15g};"):
            kind(**{key.rpartition(" ")[2].rpartition(".")[2]: value})


def test_a_part_may_be_switched_off() -> None:
    BoundParameters(follow=0.0, correction=0.0, surprise=0.0, acceleration=0.0)
    CarvingParameters(sigmas=0.0, assumed_sigma_m=0.0, depth_margin=0.0, depth_share=0.0)
    StaticParameters(period_ns=0, opacity=0.0)
