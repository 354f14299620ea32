"""Where things will be: motion experts, a calibrated bound, occupancy grids and the obstacles that cover them."""

from twin_node.forecast.baselines import BaselineForecaster, Baselines
from twin_node.forecast.errors import ForecastError
from twin_node.forecast.forecaster import Forecaster, ForecastParameters, ForecastQuality, ForecastResult
from twin_node.forecast.grid import GridParameters, default_grid
from twin_node.forecast.obstacles import CoverParameters, cover
from twin_node.forecast.part_motion import PartMotion
from twin_node.forecast.points import PointForecast, PointForecaster

__all__ = [
    "BaselineForecaster",
    "Baselines",
    "CoverParameters",
    "ForecastError",
    "ForecastParameters",
    "ForecastQuality",
    "ForecastResult",
    "Forecaster",
    "GridParameters",
    "PartMotion",
    "PointForecast",
    "PointForecaster",
    "cover",
    "default_grid",
]
