"""Simulated units, chambers and devices."""
