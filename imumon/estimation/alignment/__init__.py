"""Heading of a unit at rest from the earth rate, on real sites and while its accelerometers still warm up.

`stage.Alignment` is the stage of the pipeline, `estimator` its steps: `motion` finds disturbances and follows
turns, `record` keeps the slots of each position, `loudness` says when it was shaken,
`lines` and `windows` keep fast sway out of their mean,
`fit` says what a position tells under each of the `hypotheses` about slow sway and a tripod that settles, and
`posterior` gets heading and sigma from all of it.  The
method of Lee et al. as printed is `imumon.published.self_alignment`.  Nothing is imported here, so that
parameters can be read without loading the rest.
"""
