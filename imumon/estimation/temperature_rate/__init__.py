"""Temperature and its rate from a quantized sensor, in real time.

`stage.TemperatureRate` is the stage of the pipeline, `method.MultipleModelRate` its default method,
`imumon.papers.fir` the published one.
Nothing is imported here, so that a device file can be read without loading the estimators.
"""
