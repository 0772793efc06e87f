"""Bias of each gyro: updates at rest, a thermal model or a slope at all times; read `rest` first."""
