"""Calibration: gyro and accelerometer bias over temperature, hard and soft iron, export to autopilots."""

SHOWN = {"rad/s": ("°/h", 206264.80624709636), "m/s^2": ("mg", 1e3 / 9.80665)}
"""What a person reads, and how many of it one of a model's units is."""
