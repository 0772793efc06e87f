"""Temperature and its rate from a quantized sensor, in real time.

`stage.TemperatureRate` is the stage of the pipeline; `level_bank.LevelBankRate` is its default method,
`fir.FirExponentialRate` the published one.  The methods that both are compared with are in `comparison`.
Nothing is imported here, so that a device file can be read without loading the estimators.
"""
