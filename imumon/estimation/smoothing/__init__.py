"""Estimates of temperature and gyro bias at each time of a recording from earlier and later samples.

`record` keeps the outputs of the forward run and runs the same stages with time reversed, and
`stage.SmoothedEstimates` weighs both and adds the columns.  Nothing is imported here.
"""
