"""Is the unit at rest?

`stage.RestDetector` is the stage of the pipeline and `detector` decides slot by slot: by `windows`, the tests
of a resting unit against the noise it had, and by `trial`, those that need no knowledge of the noise.
Nothing is imported here, so that parameters can be read without loading the detector.
"""
