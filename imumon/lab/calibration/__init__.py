"""Calibration: gyro and accelerometer bias over temperature, hard and soft iron, export to autopilots."""

import math

# By the unit in the model file: the unit that is shown, and the factor to it; g is the standard gravity.
SHOWN = {"rad/s": ("°/h", math.degrees(3600.0)), "m/s^2": ("mg", 1e3 / 9.80665)}
