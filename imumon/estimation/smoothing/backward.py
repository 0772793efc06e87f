"""The same stages with time reversed.

Reversed in time, a rotation by ω is one by -ω: the rates change their sign, and so does the estimated bias.
Time counts from the end of each run, and the order of the runs is reversed.
"""

from __future__ import annotations

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, SampleBlock
from imumon.estimation.smoothing.record import QUANTITIES, THERMOMETERS, Record, value_and_sd
from imumon.pipeline import Estimator

REVERSED = {"temperature_estimate": 1.0, "temperature_rate": -1.0, "gyro_bias": -1.0}
"""Sign of each quantity when time is reversed."""


def backward(record: Record, temperature: Estimator, bias: Estimator) -> dict[str, FloatArray]:
    """Return temperature, its rate and the bias, with their sigmas, by what comes later, (n,) each.

    Parameters
    ----------
    temperature, bias : Estimator
        New stages.  That of the bias has no bias model: the modelled bias is subtracted from the rates here.
    """
    ends = np.flatnonzero(np.diff(record.run, append=-1))
    last_ns = record.middle_ns[ends][np.searchsorted(record.run[ends], record.run)]
    # The modelled bias: zero without a model, NaN while it is not known.
    model = record.vector("gyro_bias") - record.vector("gyro_random_error")
    modelled = (np.nan_to_num(model) != 0.0).any(0)
    model = np.where(np.isfinite(model) | modelled, model, 0.0)
    columns: dict[str, ColumnArray] = {
        "device_time_ns": last_ns - record.middle_ns,
        "segment": record.run.max(initial=0) - record.run,
    }
    for j, axis in enumerate("xyz"):
        columns[f"gyro_{axis}"] = model[:, j] - record.columns[f"gyro_{axis}"]
        columns[f"accel_{axis}"] = record.columns[f"accel_{axis}"]
    columns |= {
        name: record.columns[name] for name in THERMOMETERS if np.isfinite(record.columns[name]).any()
    }
    block = SampleBlock({name: np.ascontiguousarray(values[::-1]) for name, values in columns.items()})
    block = block.with_columns(temperature.process(block))
    block = block.with_columns(bias.process(block))
    found = {}
    for quantity, suffix in QUANTITIES:
        value, sd = value_and_sd(quantity, suffix)
        if value in block:
            found[value], found[sd] = REVERSED[quantity] * block[value][::-1], block[sd][::-1]
    for j, axis in enumerate("xyz"):
        found[f"gyro_bias_{axis}"] += model[:, j]
    return found
