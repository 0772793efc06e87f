"""A glance at the session that is running: does a better model exist, by the likelihood of the diagnosis?

One run from power-on, and one effect at a time, on any of the gyros.  The whole
diagnosis tries more, and proves what it names on other data.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.polynomial import Polynomial

from imumon.blocks import FloatArray
from imumon.diagnosis.blocks import (
    BLOCK_S,
    LEAST_BLOCKS,
    RunBlocks,
    common_block_s,
    make_blocks,
    survey,
    white_floor,
)
from imumon.diagnosis.candidates import Candidate, Pool, candidates
from imumon.diagnosis.channel import Declared, ordinary
from imumon.diagnosis.drivers import recorded, with_drivers
from imumon.diagnosis.earth import ALLOWANCE, turned
from imumon.diagnosis.fit import MATERIAL
from imumon.diagnosis.gains import SHORT_LIST, Scored, families
from imumon.diagnosis.known import CUBIC, temperature_of
from imumon.diagnosis.lacks import Lack, Ways, lacks
from imumon.diagnosis.likelihood import Likelihood, Noise, coarse_grid, fine_grid
from imumon.diagnosis.runs import SECOND_NS, Run
from imumon.diagnosis.selection import REFINEMENTS
from imumon.effects.base import Survey
from imumon.effects.library import EFFECTS
from imumon.effects.temperature_curve import TemperatureCurve
from imumon.geodesy import EARTH_RATE
from imumon.models.model import BiasModel, ChannelModel
from imumon.models.predictor import BiasPredictor

OWN = ("run", "event")
"""Scopes of what no model file can have."""
MOST_CLOSE = 6
"""Effects whose parameters are looked at closely: twice as many as are named in a set."""


@dataclass(frozen=True, slots=True)
class Better:
    """A better model of a channel."""

    channel: str
    names: list[str]
    """What it has that the present model lacks, the best first; the others are not told from it yet."""
    gain: float
    """In BIC, over all channels that lack the same, less what the choice costs."""
    before: float
    after: float
    """rms of means of blocks with the present model and a constant, and with the better one."""
    model: ChannelModel


def residual(
    run: Run,
    model: BiasModel,
    channels: Sequence[str],
    drivers: Sequence[str] = (),
    block_s: float = BLOCK_S,
) -> RunBlocks:
    """Return means of blocks of what a model leaves of the channels, effects carried along from power-on.

    `drivers` are what else may drive effects than temperature, time and specific force.
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
    """Return a run at rest only where its temperatures are those that a model was made of.

    Beyond these its curve goes on straight for want of better: what is left there is no effect.
    """
    inside = np.ones(len(run.time_s), bool)
    for name in channels:
        values = run.mean[temperature_of(name, model, [run])]
        known = np.isfinite(values)
        inside &= model.channels[name].inside(np.interp(run.time_s, run.time_s[known], values[known]))
    return replace(run, rest=np.where(inside, run.rest, 0.0))


def better_models(run: Run, model: BiasModel, channels: Sequence[str]) -> list[Better]:
    """Return the better models of channels of which there are any; look as often as you like."""
    temperatures = [temperature_of(name, model, [run]) for name in channels]
    block_s = common_block_s([run])
    blocks = residual(run, model, channels, recorded([run], [], temperatures, None, []), block_s)
    if len(blocks) < LEAST_BLOCKS:
        return []
    likelihood, glances = Likelihood([blocks]), dict[str, _Glance]()
    looked: dict[str, _Looked] = {}
    for name, temperature in zip(channels, temperatures, strict=True):
        if temperature not in glances:
            glances[temperature] = _Glance(Pool([blocks], temperature), likelihood)
        looked[name] = glances[temperature].at(name)
    # What is missing of a model that leaves hardly more than the white noise is too small to matter.
    matters = {
        name
        for name, one in looked.items()
        if one.before >= MATERIAL * white_floor([run], name, block_s).of_blocks([blocks]).sd
    }
    if not matters:
        return []
    tried = {name: dict(one.leaders) for name, one in looked.items()}
    ways = _shared(looked, tried, likelihood.price)
    gains = {
        name: {way: one.gain + one.choice if way == ways.effect[way] else one.fit for way, one in own.items()}
        for name, own in tried.items()
    }
    return [
        looked[name].better(model.channels[name], lack, tried[name][lack.way])
        for lack in lacks(gains, ways)
        for name in lack.channels
        if name in matters
    ]


def _shared(looked: Mapping[str, _Looked], tried: dict[str, dict[str, _Tried]], price: float) -> Ways:
    """Return the ways in which effects may be missing, with those added to what was tried whose nonlinear
    parameters, those of one of the channels, are the same for all; `price` is that of a parameter."""
    own = [one for leaders in tried.values() for one in leaders.values()]
    effect, cost = {one.name: one.name for one in own}, {one.name: one.choice for one in own}
    usual = sum(paid == 0.0 for paid in cost.values())
    several = [candidate for one in looked.values() for candidate in one.closest]
    shared = {f"{candidate.family}, shared {at}": candidate for at, candidate in enumerate(several)}
    for way, candidate in shared.items():
        effect[way], cost[way] = candidate.family, candidate.nonlinear * price + candidate.choice
    for name, one in looked.items():
        tried[name] |= one.fitted(shared)
    return Ways(effect, cost, usual)


@dataclass(frozen=True, eq=False)
class _Base:
    """What candidates are tried beside: the constants of a channel, and the curve where that is fitted anew.

    `levels` (n, k) and `powers` (n, degree) are the columns, `nothing` and `noise` are the log-likelihood of
    the present model and the noise that suits it best.
    """

    pool: Pool
    likelihood: Likelihood
    values: FloatArray
    levels: FloatArray
    powers: FloatArray
    nothing: float
    noise: Noise

    @property
    def columns(self) -> FloatArray:
        """Those of constants and curve, (n, k + degree)."""
        return np.column_stack([self.levels, self.powers])

    @cached_property
    def gain(self) -> float:
        """That of the curve alone, in BIC."""
        ratio = 2.0 * (self.likelihood.best(self.values, self.columns)[0] - self.nothing)
        return float(ratio - self.powers.shape[1] * self.likelihood.price)

    def scored(self, tried: Sequence[Candidate], grid: Sequence[Noise]) -> list[Scored]:
        """Return candidates with their gain over the present model, that of the curve with it."""
        terms, price = [self.pool.terms(candidate)[0] for candidate in tried], self.likelihood.price
        found, noise = self.likelihood.scan(self.values, self.columns, self.pool, terms, grid)
        scored = []
        for candidate, own, value, point in zip(tried, terms, found.tolist(), noise, strict=True):
            fit = 2.0 * (value - self.nothing) - (self.powers.shape[1] + len(own)) * price
            scored.append(Scored(candidate, fit - candidate.nonlinear * price - candidate.choice, fit, point))
        return scored


@dataclass(frozen=True, slots=True)
class _Tried:
    """A candidate beside a base, or None for the curve alone."""

    one: Scored | None
    base: _Base

    @property
    def name(self) -> str:
        """Name of the effect."""
        return TemperatureCurve.name if self.one is None else self.one.family

    @property
    def gain(self) -> float:
        """Over the present model, in BIC."""
        return self.base.gain if self.one is None else self.one.gain

    @property
    def fit(self) -> float:
        """The same less the price of the linear parameters alone."""
        return self.base.gain if self.one is None else self.one.fit

    @property
    def choice(self) -> float:
        """What of the gain it paid for having been chosen among other drivers."""
        return 0.0 if self.one is None else self.one.candidate.choice

    @property
    def effects(self) -> list[Candidate]:
        """The candidate, if there is one."""
        return [] if self.one is None else [self.one.candidate]

    def refined(self, seen: Survey) -> _Tried:
        """Return it with its nonlinear parameters refined, and the noise that then suits best."""
        if self.one is None or not self.one.candidate.nonlinear:
            return self
        best = self.one
        for level in range(REFINEMENTS):
            tried = [best.candidate, *best.candidate.neighbours(seen, level)]
            best = max(self.base.scored(tried, self.base.likelihood.neighbours(best.noise)), key=_gain)
        return _Tried(best, self.base)


def _gain(one: Scored | _Tried) -> float:
    return one.gain


def _closest(leaders: Mapping[str, _Tried]) -> list[_Tried]:
    return sorted(leaders.values(), key=_gain)[-MOST_CLOSE:]


@dataclass(frozen=True, eq=False)
class _Looked:
    """A channel that is looked at: its means (n,), and the columns of its constants (n, k)."""

    glance: _Glance
    name: str
    values: FloatArray
    levels: FloatArray

    @cached_property
    def bases(self) -> list[_Base]:
        """The constants alone, and with the curve fitted anew."""
        return self.glance.bases(self.values, self.levels)

    @cached_property
    def leaders(self) -> dict[str, _Tried]:
        """The best of each effect; the most likely ones with their parameters refined."""
        found = [one for base in self.bases for one in self.glance.tried(base)]
        leaders = {one.name: one for one in sorted(found, key=_gain)}
        return leaders | {one.name: one.refined(self.glance.survey) for one in _closest(leaders)}

    @property
    def closest(self) -> list[Candidate]:
        """The likeliest ones that have parameters to be the same for all channels."""
        each = [candidate for one in _closest(self.leaders) for candidate in one.effects]
        return [candidate for candidate in each if candidate.nonlinear]

    def fitted(self, several: Mapping[str, Candidate]) -> dict[str, _Tried]:
        """Return candidates whose parameters are those of another channel, of effects that are tried here,
        with the noise of the best of their effect or one beside it."""
        found: dict[str, _Tried] = {}
        for family, leader in self.leaders.items():
            ways = [way for way, one in several.items() if one.family == family]
            if not ways or leader.one is None:
                continue
            for base in self.bases:
                grid = base.likelihood.neighbours(leader.one.noise)
                scored = base.scored([several[way] for way in ways], grid)
                for way, one in zip(ways, scored, strict=True):
                    found[way] = max(found.get(way, _Tried(one, base)), _Tried(one, base), key=_gain)
        return found

    @property
    def before(self) -> float:
        """rms of what the present model and constants leave."""
        return self._rms(self.levels)

    def better(self, model: ChannelModel, lack: Lack, best: _Tried) -> Better:
        """Return the better model, with what the channel lacks as it was tried."""
        design = np.column_stack([best.base.columns, best.base.pool.design(best.effects)])
        coefficients, after = ordinary(design, self.values), self._rms(design)
        split = self.levels.shape[1]
        constant, rest = coefficients[:split].mean(), coefficients[split:]
        # What is left holds the white noise of the means as well: no smaller than it is.
        sd = min(model.residual_sd, after)
        extended = self.glance.extended(model, best, np.array([constant, *rest]), sd)
        return Better(self.name, lack.names, lack.gain, self.before, after, extended)

    def _rms(self, design: FloatArray) -> float:
        left = self.values - design @ ordinary(design, self.values)
        return float(np.sqrt(np.mean(left**2)))


class _Glance:
    """What is tried on channels that are over the same temperature."""

    def __init__(self, pool: Pool, likelihood: Likelihood) -> None:
        self._pool, self._likelihood = pool, likelihood
        self._blocks = pool.runs[0]
        seen = survey(pool.runs, pool.temperature, CUBIC, self._blocks.block_s)
        degree = CUBIC if seen.thermal else 0
        self._declared = Declared.over(pool.runs, pool.temperature, degree, "")
        self._turned = turned(pool.runs)
        self.survey = with_drivers(seen, pool.runs, pool.temperature)
        self._candidates = _simple(self.survey)

    def at(self, name: str) -> _Looked:
        """Return what is seen of a channel."""
        values = self._blocks.mean[name]
        return _Looked(self, name, values, self._levels(values))

    def _levels(self, values: FloatArray) -> FloatArray:
        """Return the columns of the constants of a channel, (n, k): one, or one for each pose.

        In each pose a gyro sees another part of the earth rate: what the poses differ by is none of the
        bias's unless it is more than that can be.
        """
        pose = self._blocks.pose
        which = np.asarray(pose[:, np.newaxis] == np.unique(pose), np.float64)
        spread = float(np.ptp(values @ which / which.sum(axis=0)))
        seen = self._turned and spread <= 2.0 * ALLOWANCE * EARTH_RATE
        return which if seen else np.ones((len(values), 1))

    def bases(self, values: FloatArray, levels: FloatArray) -> list[_Base]:
        """Return what candidates are tried beside on a channel."""
        nothing, noise = self._likelihood.best(values, levels)
        powers = self._declared.columns(self._blocks.temperature[self._pool.temperature])[:, 1:]
        return [
            _Base(self._pool, self._likelihood, values, levels, powers[:, :degree], nothing, noise)
            for degree in sorted({0, self._declared.degree})
        ]

    def tried(self, base: _Base) -> list[_Tried]:
        """Return the best few of each effect beside a base, looked at closely, and the curve alone."""
        short = families(base.scored(self._candidates, coarse_grid(base.noise)), SHORT_LIST).values()
        finely = base.scored([one.candidate for group in short for one in group], fine_grid(base.noise))
        alone = [_Tried(None, base)] if base.powers.shape[1] else []
        return [*(_Tried(one, base) for one in finely), *alone]

    def extended(
        self, model: ChannelModel, one: _Tried, coefficients: FloatArray, residual_sd: float
    ) -> ChannelModel:
        from imumon.diagnosis.extended import refitted

        split = 1 + one.base.powers.shape[1]
        middle, half = self._declared.middle_degc, self._declared.half_span_degc
        more = Polynomial(coefficients[:split], domain=[middle - half, middle + half])
        effects = [effect for effect in model.effects if effect.polynomial() is None]
        effects += [
            candidate.parts[0].effect.with_coefficients(coefficients[split:]) for candidate in one.effects
        ]
        return refitted(model, more, effects, residual_sd)


def _simple(seen: Survey) -> list[Candidate]:
    """Return what may be in a model file, each effect by itself and begun in equilibrium."""
    return [
        candidate
        for candidate in candidates(seen, [name for name, kind in EFFECTS.items() if kind.scope not in OWN])
        if getattr(candidate.parts[0].effect, "order", 1) == 1
        and not (candidate.whole or candidate.free_start or len(candidate.parts) > 1)
    ]
