"""Which estimators run behind the clock, and in which order."""

from __future__ import annotations

from collections.abc import Sequence

from imumon.allan.live import AllanStage
from imumon.estimation.attitude.stage import AttitudeEstimate
from imumon.estimation.gyro_bias.stage import RestAndBias
from imumon.estimation.spectrum.stage import LiveSpectrum
from imumon.estimation.temperature_rate.stage import TemperatureRate
from imumon.estimation.watch.stage import ModelWatch
from imumon.pipeline import Estimator, Pipeline
from imumon.plugins import STAGES, plugins
from imumon.protocols.device import DeviceFile
from imumon.protocols.ranges import Ranges
from imumon.protocols.thermometer import TemperatureRateParameters
from imumon.recordings.source import Source
from imumon.run.setup import Setup
from imumon.stage import STAGE, is_callable, made_by
from imumon.wings import offers


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
    stages = [stage for stage in estimators(device, setup) if isinstance(stage, only)] if only else []
    return Pipeline(device, [*stages, *more], setup.range.over(declared))


def estimators(device: DeviceFile | None, setup: Setup | None = None) -> list[Estimator]:
    """Return new estimators for a device, or for a table when there is none; those of plug-ins come last.

    The heading is sought only where the latitude is known.

    Raises BAD_CONFIG for a plug-in that makes no stage, naming it.
    """
    setup = setup or Setup()
    temperature = device.temperature if device is not None else TemperatureRateParameters()
    model = setup.bias_model
    axes = device.axes if device is not None else None
    stages: list[Estimator] = [
        TemperatureRate(parameters=temperature),
        RestAndBias(
            setup.zupt_with_noise, model, setup.mode, setup.latitude_deg, setup.heading_deg, setup.rest
        ),
        ModelWatch(setup.watch, modelled=model is not None),
        AllanStage(setup.allan),
        LiveSpectrum(),
        AttitudeEstimate(setup.attitude, axes, setup.magnetometer, setup.latitude_deg, setup.heading_deg),
    ]
    if setup.latitude_deg is not None:
        from imumon.estimation.alignment.stage import Alignment  # scipy.signal and .spatial take 0.7 s

        sent = () if device is None else [column.name for column in device.decoder().possible_columns]
        stages.append(Alignment(setup.alignment_with_warm_up, setup.latitude_deg, axes, sent))
    for more in offers("stages"):
        stages += more(setup, temperature, stages)
    return [*stages, *map(made_by, plugins(STAGES, STAGE, is_callable))]
