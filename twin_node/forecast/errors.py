"""The forecast room's error."""

from twin_node.errors import TwinError


class ForecastError(TwinError):
    """A workspace, grid or parameter given to the forecaster is unusable."""
