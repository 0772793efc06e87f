"""Heading of a unit at rest from the earth rate, on real sites and while its accelerometers still warm up.

`stage.Alignment` is the stage of the pipeline and `aligner` its state and steps.  `position` detects motion
and holds the rows of a rest in one attitude.  `fit` gives the horizontal rate of a position for each
hypothesis about slow tilts and drifts, and `posterior` the heading and its sigma from all positions and the
prior of the sensors' errors.  `report` is what a user reads of it.

Nothing is imported here, so that parameters load without the rest.
"""
