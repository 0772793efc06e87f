"""Is the unit at rest?  Rest and bias are one estimator: `imumon.estimation.gyro_bias.estimator`."""
