"""Heading of a unit at rest from the earth rate, on real sites and while its accelerometers still warm up.

`stage.Alignment` is the stage of the pipeline and `aligner` its steps.  `positions` decides what is rest and
what a turn, `record` keeps the rows of a position, `sway` and `cells` keep sway and knocks out of their mean,
`hypotheses` says what a position tells of the rate if it stands or settles, `prior` what sensors of such
noise may be wrong by, and `posterior` gets heading and sigma from all of it.  The method of Lee et al. as
printed is `imumon.published.self_alignment`.

Nothing is imported here, so that parameters load without the rest.
"""
