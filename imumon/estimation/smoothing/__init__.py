"""What a recording tells of temperature and bias when its future is known as well.

`record` keeps what the stages said forward, `backward` runs the same stages against time, `combine` makes one
estimate of two, and `stage.Smoothed` puts it beside the samples.  Nothing is imported here.
"""
