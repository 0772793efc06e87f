"""Bias of each gyro: updates at rest, temperature in between; read `imumon.estimation.rest` first."""
