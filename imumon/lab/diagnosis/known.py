"""A bias model that is known: what it expects is taken from runs, what it has is the start of a search."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from imumon.columns import TEMPERATURES
from imumon.effects.base import Effect
from imumon.effects.vibration import SECOND_NS
from imumon.errors import bad_config, bad_data
from imumon.lab.diagnosis.blocks import RunBlocks, common_block_s, make_blocks
from imumon.lab.diagnosis.runs import Run
from imumon.models.curves.polynomial import PolynomialCurve
from imumon.models.model import BiasModel, ChannelModel
from imumon.models.predictor import BiasPredictor

CUBIC_DEGREE = 3
"""As what is assumed without a model: other curves keep their shape, and have a cubic added."""


def channels_with_model(channels: Sequence[str], model: BiasModel) -> list[str]:
    """Return the channels that a model has; raises BAD_CONFIG where it has none of them."""
    if found := [name for name in channels if name in model.channels]:
        return found
    raise bad_config(
        f"the model has {', '.join(model.channels)}; the data has {', '.join(channels)}",
        "give the model of this unit, or --declared",
    )


def temperature_of(channel: str, model: BiasModel | None, runs: Sequence[Run]) -> str:
    """Return the temperature that the curve of a channel is over: that of the model, or of its axis, or
    another that every run has.

    Raises BAD_DATA without any.
    """
    wanted = f"temperature_{channel[-1]}"
    if model is not None:
        wanted = model.channels[channel].temperature_column.replace("_estimate", "")
    for name in (wanted, *TEMPERATURES):
        if name != channel and all(np.isfinite(run.mean.get(name, np.nan)).sum() > 1 for run in runs):
            return name
    raise bad_data(
        "there is no temperature that every run has, and a bias model is over one",
        "record with the temperature switched on, or name its column in the map",
    )


def check_range(model: BiasModel, temperatures: Mapping[str, str], runs: Sequence[RunBlocks]) -> None:
    """Refuse a model whose curves hold at no temperature of the runs: nothing of them could be fitted anew.

    Raises BAD_CONFIG, naming both ranges.
    """
    for name, temperature in temperatures.items():
        found = np.concatenate([run.temperature[temperature] for run in runs])
        low, high = model.channels[name].temperature_range_degc
        if max(low, float(found.min())) >= min(high, float(found.max())):
            raise bad_config(
                f"the bias model of {name} holds from {low:.2f} to {high:.2f} °C, the training data has"
                f" {found.min():.2f} to {found.max():.2f} °C: they do not overlap",
                "give a model that was calibrated at these temperatures, or none: leave --model out",
            )


def order_of(channel: ChannelModel) -> int:
    """Return the degree of the polynomial by which a curve is fitted anew: its own, or a cubic's."""
    curve = channel.curve
    return len(curve.coefficients) - 1 if isinstance(curve, PolynomialCurve) else CUBIC_DEGREE


def effects_of(channel: ChannelModel) -> tuple[Effect, ...]:
    """Return the effects of a model beside its curve, and what is part of that."""
    return tuple(effect for effect in channel.effects if effect.polynomial() is None)


def without_curves(run: Run, model: BiasModel, channels: Sequence[str]) -> Run:
    """Return a run with the curves of a model, and no effect beside them, taken from its channels."""
    curves = {}
    for name, channel in model.channels.items():
        parts = [effect for effect in channel.effects if effect.polynomial() is not None]
        curves[name] = channel.model_copy(update={"effects": parts})
    return without_model(run, model.model_copy(update={"channels": curves}), channels)


def without_model(run: Run, model: BiasModel, channels: Sequence[str]) -> Run:
    """Return a run with what a model expects taken from its channels, effects integrated from power-on."""
    channels = [name for name in channels if name in run.mean]
    temperatures = [temperature_of(name, model, [run]) for name in channels]
    force = [run.mean[f"accel_{axis}"] for axis in "xyz" if f"accel_{axis}" in run.mean]
    expected = BiasPredictor(model, channels).process(
        np.round(run.time_s * SECOND_NS).astype(np.int64),
        np.zeros(len(run.time_s), np.int64),
        np.column_stack([run.mean[name] for name in temperatures]),
        np.column_stack(force) if len(force) == 3 else None,
        run.mean,
    )
    changed = {name: run.mean[name] - expected.bias[:, at] for at, name in enumerate(channels)}
    return replace(run, mean={**run.mean, **changed})


def residual(run: Run, model: BiasModel, channels: Sequence[str]) -> RunBlocks:
    """Return block means of what a model leaves of the channels, its effects integrated from power-on."""
    temperatures = dict.fromkeys(temperature_of(name, model, [run]) for name in channels)
    left = without_model(run, model, channels)
    return make_blocks(left, channels, [*temperatures], block_s=common_block_s([run]))


def within_range(model: BiasModel, run: Run, channels: Sequence[str], until_s: float | None = None) -> Run:
    """Return a run at rest only where its temperatures are inside the range that a model was fitted on, or
    those that the run itself had until then.

    Outside that range the curve continues as a straight line, and what is left there is no effect.
    """
    inside = np.ones(len(run.time_s), bool)
    for name in channels:
        values = run.mean[temperature_of(name, model, [run])]
        known = np.isfinite(values)
        if until_s is None:
            inside &= model.channels[name].inside(np.interp(run.time_s, run.time_s[known], values[known]))
        else:
            early = values[(run.time_s < until_s) & known]
            inside &= (values >= early.min()) & (values <= early.max())
    return replace(run, rest=np.where(inside, run.rest, 0.0))
