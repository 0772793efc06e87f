"""What a gyro reads at rest beside its thermal bias: slow drift, with a true standard deviation.

`stage.RandomError` is the stage of the pipeline; `drift.DriftFilter` its default method, `sigma_points` the
published SR-UKF and SR-RSUKF, `linear` the published Kalman filters, `baselines` what they are compared with.
Nothing is imported here, so that parameters can be read without loading the estimators.
"""
