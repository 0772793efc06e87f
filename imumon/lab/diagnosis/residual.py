"""What a model leaves of the session that is running, and the better models that the search finds in it."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import Polynomial

from imumon.effects.base import Survey
from imumon.effects.library import EFFECTS
from imumon.geodesy import EARTH_RATE
from imumon.lab.diagnosis.blocks import (
    BLOCK_S,
    LEAST_BLOCKS,
    RunBlocks,
    common_block_s,
    make_blocks,
    survey,
    white_floor,
)
from imumon.lab.diagnosis.candidates import Candidate, Pool, candidates
from imumon.lab.diagnosis.channel import Channel, Declared, Own, residual_rms
from imumon.lab.diagnosis.choice import lacks, proof
from imumon.lab.diagnosis.drivers import recorded, with_drivers
from imumon.lab.diagnosis.earth import ALLOWANCE, turned
from imumon.lab.diagnosis.extended import refitted
from imumon.lab.diagnosis.fit import MATERIAL, fit
from imumon.lab.diagnosis.known import CUBIC, effects_of, temperature_of
from imumon.lab.diagnosis.likelihood import Likelihood
from imumon.lab.diagnosis.runs import SECOND_NS, Run, unit_of
from imumon.lab.diagnosis.search import MOST_NAMES, Search
from imumon.models.model import BiasModel, ChannelModel
from imumon.models.predictor import BiasPredictor

LASTING = [name for name, kind in EFFECTS.items() if kind.scope not in ("run", "event")]
"""Effects that a model file can have."""


@dataclass(frozen=True, slots=True)
class Better:
    """A better model of a channel.

    `names` are the effects of which the present model lacks one, the best first; these data do not tell them
    apart.  `gain` is in BIC over the present model, of all channels that lack an effect.  `before` and
    `after` are the rms of the block means with the present model and a constant, and with the better model.
    """

    channel: str
    names: list[str]
    gain: float
    before: float
    after: float
    model: ChannelModel


def residual(
    run: Run,
    model: BiasModel,
    channels: Sequence[str],
    drivers: Sequence[str] = (),
    block_s: float = BLOCK_S,
) -> RunBlocks:
    """Return block means of what a model leaves of the channels, its effects integrated from power-on.

    `drivers` are the recorded columns that may drive effects besides temperature, time and specific force.
    """
    temperatures = {name: temperature_of(name, model, [run]) for name in channels}
    n = len(run.time_s)
    force = [run.mean[f"accel_{axis}"] for axis in "xyz" if f"accel_{axis}" in run.mean]
    bias = (
        BiasPredictor(model, channels)
        .process(
            np.round(run.time_s * SECOND_NS).astype(np.int64),
            np.zeros(n, np.int64),
            np.column_stack([run.mean[temperatures[name]] for name in channels]),
            np.column_stack(force) if len(force) == 3 else None,
            run.mean,
        )
        .bias
    )
    changed = {name: run.mean[name] - bias[:, at] for at, name in enumerate(channels)}
    left = replace(run, mean={**run.mean, **changed})
    return make_blocks(left, channels, list(dict.fromkeys(temperatures.values())), drivers, block_s)


def known_to(model: BiasModel, run: Run, channels: Sequence[str]) -> Run:
    """Return a run at rest only where its temperatures are inside the range that a model was fitted on.

    Outside that range the curve continues as a straight line, and what is left there is no effect.
    """
    inside = np.ones(len(run.time_s), bool)
    for name in channels:
        values = run.mean[temperature_of(name, model, [run])]
        known = np.isfinite(values)
        inside &= model.channels[name].inside(np.interp(run.time_s, run.time_s[known], values[known]))
    return replace(run, rest=np.where(inside, run.rest, 0.0))


def better_models(run: Run, model: BiasModel, channels: Sequence[str]) -> list[Better]:
    """Return a better model of each channel that lacks an effect.

    The search of the diagnosis runs on the residual of the present model twice: with its curve as it is, and
    with the curve fitted anew; the likelier of the two counts.  One effect is named at a time, where the gain
    over the present model, of all channels that lack it, pays for the choice of effect, channels and curve
    (extended BIC).
    """
    temperatures = {name: temperature_of(name, model, [run]) for name in channels}
    used = list(dict.fromkeys(temperatures.values()))
    block_s = common_block_s([run])
    blocks = residual(run, model, channels, recorded([run], [], used, None, []), block_s)
    if len(blocks) < LEAST_BLOCKS:
        return []
    present = _channels(run, blocks, temperatures, 0)
    before = {one.name: residual_rms(one.base, one.values) for one in present}
    # What a model leaves hardly above the white noise is too small to matter.
    material = [one.name for one in present if before[one.name] >= MATERIAL * one.floor.sd]
    if not material:
        return []
    shown = with_drivers(survey([blocks], used[0], 0, block_s), [blocks], used[0])
    bases = {0: present} | ({CUBIC: _channels(run, blocks, temperatures, CUBIC)} if shown.thermal else {})
    likelihood = Likelihood([blocks])
    nothing = {one.name: _score(one, [], likelihood) for one in present}
    least = proof(len(bases) * len(LASTING), len(channels))
    best, gain = dict[str, _Found](), least
    for degree, base in bases.items():
        found = _lacking(base, replace(shown, degree=degree), likelihood, least)
        total = sum(
            _score(one.channel, [one.candidate], likelihood) - nothing[name] for name, one in found.items()
        )
        if total > gain:
            best, gain = found, total
    return [
        _better(one, gain, before[name], model.channels[name])
        for name, one in best.items()
        if name in material
    ]


@dataclass(frozen=True, slots=True)
class _Found:
    """What a channel lacks: the effects that are not told apart, and the first of them as a candidate."""

    channel: Channel
    names: list[str]
    candidate: Candidate


def _lacking(
    channels: Sequence[Channel], shown: Survey, likelihood: Likelihood, least: float
) -> dict[str, _Found]:
    """Return what the first stage of the search, over all channels at once, finds in each."""
    tried = candidates(shown, LASTING)
    searches = {one.name: Search(one, shown, likelihood, tried) for one in channels}
    tables = {name: search.table() for name, search in searches.items()}
    return {
        name: _Found(
            searches[name].channel,
            lack.names[:MOST_NAMES],
            searches[name].refined(tables[name][lack.names[0]]).candidate,
        )
        for lack in lacks(tables, least)
        for name in lack.channels
    }


def _score(channel: Channel, found: Sequence[Candidate], likelihood: Likelihood) -> float:
    """Return twice the log-likelihood of a channel less the price of curve and effects (BIC)."""
    design = channel.design(found)
    number = design.shape[1] - channel.base.shape[1] + channel.declared.degree
    number += sum(one.nonlinear for one in found)
    price = number * likelihood.price + sum(one.choice for one in found)
    return float(2.0 * likelihood.best(channel.values, design)[0] - price)


def _better(found: _Found, gain: float, before: float, present: ChannelModel) -> Better:
    """Return the present model of a channel with what it lacks, fitted."""
    channel = found.channel
    fitted = fit(channel, [found.candidate])
    middle, half = channel.declared.middle_degc, channel.declared.half_span_degc
    curve = Polynomial(fitted.declared, domain=[middle - half, middle + half])
    effects = [*effects_of(present), *(part.effect.with_start(part.start) for part in fitted.parts)]
    # What is left holds the white noise of the means as well: the model's own error is no larger.
    model = refitted(present, curve, effects, min(present.residual_sd, fitted.train_rms))
    return Better(channel.name, found.names, gain, before, fitted.train_rms, model)


def _channels(run: Run, blocks: RunBlocks, temperatures: Mapping[str, str], degree: int) -> list[Channel]:
    """Return the residuals as channels of a search, with a polynomial of temperature fitted beside it.

    In each pose a gyro measures another part of the earth rate.  Where the poses differ by no more than that,
    each has a constant of its own.
    """
    pools = {temperature: Pool([blocks], temperature) for temperature in temperatures.values()}
    tilted = turned([blocks])
    found = []
    for name, temperature in temperatures.items():
        values, pose = blocks.mean[name], blocks.pose
        levels = [values[pose == number].mean() for number in np.unique(pose)]
        own: Own = "pose" if tilted and np.ptp(levels) <= 2.0 * ALLOWANCE * EARTH_RATE else ""
        floor = white_floor([run], name, blocks.block_s).of_blocks([blocks])
        declared = Declared.over([blocks], temperature, degree, own)
        found.append(Channel(name, unit_of(name), floor, declared, pools[temperature], []))
    return found
