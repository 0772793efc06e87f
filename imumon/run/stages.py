"""Which estimators run behind the clock, and in which order; and a recording backward through the same."""

import math
from collections.abc import Sequence
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from imumon.estimation.alignment.stage import Alignment
from imumon.estimation.attitude.stage import AttitudeEstimate
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.estimation.smoothing.stage import Recorder, SmoothedEstimates, backward, still_heading
from imumon.estimation.spectrum.stage import LiveSpectrum
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.estimation.watch.stage import ModelWatch
from imumon.pipeline import Estimator, Pipeline
from imumon.plugins import STAGES, plugins
from imumon.protocols.device import DeviceFile
from imumon.protocols.ranges import Ranges
from imumon.recordings.folder import Session, fingerprint
from imumon.recordings.source import Source, run_over
from imumon.stage import STAGE, is_callable, made_by
from imumon.version import __version__
from imumon.wing import offers

from .setup import Setup, ZuptMode, unused_keys


def pipeline_of(
    sent: DeviceFile | Source,
    setup: Setup | None = None,
    more: Sequence[Estimator] = (),
    only: tuple[type, ...] = (object,),
) -> Pipeline:
    """Return the pipeline of a device or a recording: the stages of a setup, then more.

    `only` selects the stages of the setup.
    """
    setup = setup or Setup()
    device, declared = (sent.device, sent.range) if isinstance(sent, Source) else (sent, Ranges())
    stages = [stage for stage in estimators(device, setup) if isinstance(stage, only)]
    return Pipeline(device, [*stages, *more], setup.range.over(declared), unused_keys(setup, device))


def estimators(device: DeviceFile | None, setup: Setup | None = None) -> list[Estimator]:
    """Return new estimators for a device, or for a table when there is none; those of plug-ins come last.

    The heading is sought only where the latitude is known.

    Raises BAD_CONFIG for a plug-in that makes no stage, naming it, and where parts of the setup contradict
    each other.
    """
    setup = (setup or Setup()).checked()
    temperature = None if device is None else device.temperature
    model = setup.bias_model
    axes = device.axes if device is not None else None
    stages: list[Estimator] = [
        TemperatureRate(parameters=temperature),
        RestAndBias(
            setup.zupt_with_noise, model, setup.mode, setup.latitude_deg, setup.heading_deg, setup.rest
        ),
        ModelWatch(setup.watch, modelled=model is not None),
        LiveSpectrum(),
        AttitudeEstimate(setup.attitude, axes, setup.magnetometer, setup.latitude_deg, setup.heading_deg),
    ]
    if setup.latitude_deg is not None:
        sent = () if device is None else [column.name for column in device.decoder().possible_columns]
        stages.append(Alignment(setup.alignment, setup.latitude_deg, axes, sent))
    for more in offers("stages"):
        stages += more(setup, temperature, stages)
    return [*stages, *map(made_by, plugins(STAGES, STAGE, is_callable))]


SMOOTHED = (TemperatureRate, RestAndBias, AttitudeEstimate, Alignment)
"""Stages whose estimates are smoothed."""


def smoothed(source: Source, setup: Setup) -> SmoothedEstimates:
    """Run over a recording, forward and backward; return the stage that puts the result beside its rows.

    The heading is that where the unit stood still, when the latitude is known.
    """
    recorder = Recorder()
    pipeline = pipeline_of(source, setup, only=SMOOTHED)
    pipeline.sink = recorder.add
    for _ in run_over(source.items, pipeline):
        pass
    record, stages = recorder.finish(), pipeline.estimators
    aligned = [still_heading(record, stage.finish()) for stage in stages if isinstance(stage, Alignment)]
    given = None if source.device is None else source.device.temperature
    # For the stage that goes backward the earth turns the other way.
    latitude = None if setup.latitude_deg is None else -setup.latitude_deg
    toward = setup.heading_deg
    if toward is not None:
        known = record.columns["attitude_estimate_heading"]
        known = known[np.isfinite(known)]
        toward += 180.0 + (math.degrees(known[-1] - known[0]) if len(known) else 0.0)
    mode: ZuptMode = "learned" if setup.mode == "learned" else "standard"
    bias = RestAndBias(setup.zupt_with_noise, None, mode, latitude, toward, setup.rest)
    return SmoothedEstimates(record, backward(record, TemperatureRate(parameters=given), bias), *aligned)


def keep_learned(pipeline: Pipeline, session: Session) -> Path | None:
    """Write the better model that has won in a session into its folder; return its path, or None.

    The model that the session ran with stays where it is: who wants the new one names it.
    """
    found = (one for one in pipeline.estimators if getattr(one, "offered", None) is not None)
    stage: Any = next(found, None)
    if stage is None:
        return None
    path, model = session.path / "learned-model.yaml", stage.offered.model
    evidence = stage.evidence(session.path.name, fingerprint(session.truth_path))
    model.model_copy(
        update={
            "made_by": f"imumon {__version__}",
            "created": f"{datetime.now(UTC):%Y-%m-%dT%H:%M:%SZ}",
            "trained_on": [*model.trained_on, evidence],
        }
    ).write(path)
    return path
