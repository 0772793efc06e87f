"""Bias of each gyro: zero-velocity updates at rest, a thermal model or a learned slope at all times.

Begin with `estimator`: it hands slots of samples to `imumon.estimation.rest.quiet` (does anything move?), and
quiet seconds to `hypotheses` (the bias, or a turn?) and `bank` (the Kalman filters).
"""
