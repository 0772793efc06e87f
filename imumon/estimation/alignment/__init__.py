"""Heading of a unit at rest from the earth rate, while its accelerometers still warm up.

`stage.Alignment` is the stage of the pipeline.  `loop` is the strapdown attitude with the fixed-gain control,
`kernel` runs it sample by sample, `watch` finds disturbances, `sums` holds what the estimators need in
constant memory, and `estimators` gets the headings and their sigmas from it.  Nothing is imported here, so
that parameters can be read without loading the rest.
"""
