"""Calibration: lenses, rigs and clocks from boards and motion."""
