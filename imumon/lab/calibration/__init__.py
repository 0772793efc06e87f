"""Calibration: gyro and accelerometer bias over temperature, hard and soft iron, export to autopilots."""

import math

# By the unit in the model file: the unit on screen and in plots, and the factor to it; 9.80665 m/s² is 1 g.
DISPLAY_UNITS = {"rad/s": ("°/h", math.degrees(3600.0)), "m/s^2": ("mg", 1e3 / 9.80665)}
