"""Where things will be: motion experts, a calibrated bound, occupancy grids and the obstacles that cover them."""

from twin_node.forecast.baselines import BaselineForecaster, Baselines
from twin_node.forecast.errors import ForecastError
from twin_node.forecast.grid import default_grid
from twin_node.forecast.obstacles import CoverParameters, Motion, cover
from twin_node.forecast.occupancy import Forecaster, ForecastParameters, ForecastQuality, Foreseen
from twin_node.forecast.points import PointForecast, PointForecaster

__all__ = [
    "BaselineForecaster",
    "Baselines",
    "CoverParameters",
    "ForecastError",
    "ForecastParameters",
    "ForecastQuality",
    "Forecaster",
    "Foreseen",
    "Motion",
    "PointForecast",
    "PointForecaster",
    "cover",
    "default_grid",
]
