"""A recording forward, then backward through the same stages."""

from __future__ import annotations

import math

import numpy as np

from imumon.estimation.attitude.stage import AttitudeEstimate
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.estimation.smoothing.stage import Record, Recorder, SmoothedEstimates, backward, still_heading
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.pipeline import SampleSink
from imumon.protocols.thermometer import TemperatureRateParameters
from imumon.recordings.source import Source, run_over
from imumon.run.setup import Setup, ZuptMode
from imumon.run.stages import pipeline_of

NEEDED = (TemperatureRate, RestAndBias, AttitudeEstimate)


def smoothed(source: Source, setup: Setup) -> SmoothedEstimates:
    """Run over a recording, forward and backward; return the stage that puts the result beside its rows.

    The heading is that where the unit stood still, when the latitude is known.
    """
    needed: tuple[type, ...] = NEEDED
    if setup.latitude_deg is not None:
        from imumon.estimation.alignment.stage import Alignment  # scipy.signal and .spatial take 0.7 s

        needed = (*NEEDED, Alignment)
    recorder = Recorder()
    pipeline = pipeline_of(source, setup, [SampleSink(recorder.add)], only=needed)
    for _ in run_over(source.items, pipeline):
        pass
    record, heading = recorder.finish(), None
    if setup.latitude_deg is not None:
        stage = next(stage for stage in pipeline.estimators if isinstance(stage, Alignment))
        heading = still_heading(record, stage.finish())
    given = source.device.temperature if source.device is not None else TemperatureRateParameters()
    against_time = backward(record, TemperatureRate(parameters=given), _bias(record, setup))
    return SmoothedEstimates(record, against_time, heading)


def _bias(record: Record, setup: Setup) -> RestAndBias:
    """Return the stage that goes backward, for which the earth turns the other way."""
    latitude = None if setup.latitude_deg is None else -setup.latitude_deg
    heading = None if setup.heading_deg is None else _last_heading(record, setup.heading_deg) + 180.0
    mode: ZuptMode = "learned" if setup.mode == "learned" else "standard"
    return RestAndBias(setup.zupt_with_noise, None, mode, latitude, heading, setup.rest)


def _last_heading(record: Record, first_deg: float) -> float:
    """Return the heading at the end of the recording, degrees."""
    known = record.columns["attitude_estimate_heading"]
    known = known[np.isfinite(known)]
    return first_deg + (math.degrees(known[-1] - known[0]) if len(known) else 0.0)
