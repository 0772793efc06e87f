"""Subtract the bias that a known model predicts from runs; the rest is what that model lacks."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from imumon.diagnosis.recording import SECOND_NS, Run, common_temperature
from imumon.errors import ImumonError, Reason
from imumon.models.model import BiasModel
from imumon.models.predictor import BiasPredictor


def modelled(channels: Sequence[str], model: BiasModel) -> list[str]:
    """Return the channels that the model has.

    Raises
    ------
    ImumonError
        BAD_CONFIG when there is none.
    """
    found = [name for name in channels if name in model.channels]
    if not found:
        raise ImumonError(
            Reason.BAD_CONFIG,
            f"the model has {', '.join(model.channels)}; the data has {', '.join(channels)}",
            "give the model of this unit, or --declared",
        )
    return found


def temperature_of(channel: str, model: BiasModel, runs: Sequence[Run]) -> str:
    """Return the temperature in the runs that the model's curve of a channel is over.

    Raises
    ------
    ImumonError
        BAD_DATA when a run lacks it.
    """
    name = model.channels[channel].temperature_column.replace("_estimate", "")
    return common_temperature(name, runs, f"the bias model needs {name}, which not every run has")


def without_known(run: Run, model: BiasModel, temperatures: dict[str, str]) -> Run:
    """Return a run with the model's bias, effects carried along from power-on, taken from its channels."""
    names = [name for name in temperatures if name in run.mean]
    time_ns = np.round(run.time_s * SECOND_NS).astype(np.int64)
    temperature = np.column_stack([run.mean[temperatures[name]] for name in names])
    force = [run.mean[f"accel_{axis}"] for axis in "xyz" if f"accel_{axis}" in run.mean]
    predicted = BiasPredictor(model, names).process(
        time_ns,
        np.zeros(len(time_ns), np.int64),
        temperature,
        np.column_stack(force) if len(force) == 3 else None,
        run.mean,
    )
    changed = {name: run.mean[name] - predicted.bias[:, at] for at, name in enumerate(names)}
    return replace(run, mean={**run.mean, **changed})
