"""Is the unit at rest?

`stage.RestDetector` is the stage of the pipeline, `detector` decides slot by slot: by `quiet`, whether
anything moves, and by the table of `imumon.estimation.gyro_bias`, what a steady mean of the gyros is.
Nothing is imported here, so that parameters can be read without loading the detector.
"""
