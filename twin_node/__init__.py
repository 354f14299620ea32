"""A live 4D Gaussian twin of a robot cell, with its occupancy 200 ms ahead."""

__version__ = "0.1.0"
