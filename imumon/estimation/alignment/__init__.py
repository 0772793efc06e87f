"""Heading of a unit at rest from the earth rate, on real sites and while its accelerometers still warm up.

`stage.Alignment` is the stage of the pipeline and `aligner` its state and steps.  `motion` detects motion,
`record` holds the rows of a position, and `cells` subtracts narrow-band sway and averages the rest with Hann
windows.  `hypotheses` gives the horizontal rate of a position if the unit stands or settles, `sensor_errors`
the prior of biases and scale factors, and `posterior` the heading and its sigma from all positions.  `report`
is what a user reads of it.  The method of Lee et al. as printed is `imumon.papers.self_alignment`.

Nothing is imported here, so that parameters load without the rest.
"""
