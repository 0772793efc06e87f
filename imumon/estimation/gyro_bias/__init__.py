"""Bias of each gyro: zero-velocity updates at rest, a thermal model or a learned slope at all times."""
