"""Is the unit at rest?

`slots` are what rest and bias read; `quiet` tests, slot by slot, whether anything moves; `odds` weighs a turn
against a bias that has changed.
Start with `imumon.estimation.gyro_bias.estimator`, which puts both together: rest and bias are one estimator.
Nothing is imported here, so that parameters can be read without loading the rest.
"""
