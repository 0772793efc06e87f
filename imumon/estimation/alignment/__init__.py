"""Heading of a unit at rest from the earth rate, on real sites and while its accelerometers still warm up.

From slots to the heading: `stage`, `aligner`, `position`, `fit`, `posterior`; `report` is what a user reads.
Nothing is imported here, so that parameters load without the rest.
"""
