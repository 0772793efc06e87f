"""Bias of each gyro: updates at rest, temperature in between; read `rest` first."""
