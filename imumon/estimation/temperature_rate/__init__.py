"""Temperature and its rate from a quantized sensor, in real time.

`stage.TemperatureRate` is the stage of the pipeline, `method.MultipleModelRate` its default method,
`imumon.papers.fir` the published one.
Constants with the word ablation have rows of `scripts/reproduce/ablation --part temperature_rate`, in
docs/appendix/ablation-results.md.

Nothing is imported here, so that a device file can be read without loading the estimators.
"""
