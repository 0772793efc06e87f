"""Attitude of the body by gyros, accelerometers and, where there is one, the magnetometer.

`stage.AttitudeEstimate` is the stage of the pipeline.  `fusion` runs the filter VQF over the samples;
`sigma` estimates how far its angles are off.  Nothing is imported here, so that
parameters can be read without loading the rest.
"""
