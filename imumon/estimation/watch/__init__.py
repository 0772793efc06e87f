"""Watch over the bias filter: do its innovations look as it expects, or does its model lack something?

`imumon.estimation.watch.stage.ModelWatch` is the stage; this package imports nothing by itself.
"""
