"""A glance at the session that is running: does a better model exist, by the likelihood of the diagnosis?

Each gyro by itself, one run from power-on, and one effect at a time.  The whole
diagnosis tries more, and proves what it names on other data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.polynomial import Polynomial

from imumon.blocks import FloatArray
from imumon.diagnosis.blocks import BLOCK_S, RunBlocks, make_blocks, survey, white_floor
from imumon.diagnosis.candidates import Candidate, Pool, candidates
from imumon.diagnosis.channel import Declared, ordinary
from imumon.diagnosis.drivers import recorded, with_drivers
from imumon.diagnosis.earth import ALLOWANCE, turned
from imumon.diagnosis.explaining import MATERIAL
from imumon.diagnosis.gains import CLOSE, CLOSE_SHARE, PROVEN, SHORT_LIST, Scored, families
from imumon.diagnosis.known import CUBIC, temperature_of
from imumon.diagnosis.likelihood import Likelihood, Noise, coarse_grid, fine_grid
from imumon.diagnosis.recording import SECOND_NS, Run
from imumon.diagnosis.selection import REFINEMENTS
from imumon.effects.base import Survey
from imumon.effects.library import EFFECTS
from imumon.effects.temperature_curve import TemperatureCurve
from imumon.geodesy import EARTH_RATE
from imumon.models.model import BiasModel, ChannelModel
from imumon.models.predictor import BiasPredictor

LEAST_BLOCKS = 40
"""As the whole diagnosis needs."""
OWN = ("run", "event")
"""Scopes of what no model file can have."""
MOST_CLOSE = 6
"""Effects whose parameters are looked at closely: twice as many as are named in a set."""


@dataclass(frozen=True, slots=True)
class Better:
    """A better model of a channel.

    Parameters
    ----------
    channel : str
    names : list of str
        What it has that the present model lacks, the best first; the others are not told from it yet.
    gain : float
        In BIC, less what the number of looks costs.
    before, after : float
        rms of means of blocks with the present model and a constant, and with the better one.
    model : ChannelModel
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


def block_of(run: Run) -> float:
    """Return the length in seconds of the means that a run is looked at in: 30 s, of longer slots more."""
    return BLOCK_S * run.slot_s


def better_models(run: Run, model: BiasModel, channels: Sequence[str], looks: int = 1) -> list[Better]:
    """Return the better models of channels of which there are any.

    `looks` is how often this run has been looked at, with this time: each look at each channel may be fooled.
    A gain pays for the channels as in the extended BIC (Chen & Chen 2008), and the k-th look has the share
    1 / (k (k + 1)) of what all may be fooled together, however many there will be (Bonferroni's inequality).
    """
    temperatures = [temperature_of(name, model, [run]) for name in channels]
    blocks = residual(run, model, channels, recorded([run], [], temperatures, None, []), block_of(run))
    if len(blocks) < LEAST_BLOCKS:
        return []
    likelihood, glances = Likelihood([blocks]), dict[str, _Glance]()
    price = 2.0 * float(np.log(len(channels) * looks * (looks + 1)))
    found = []
    for name, temperature in zip(channels, temperatures, strict=True):
        if temperature not in glances:
            glances[temperature] = _Glance(Pool([blocks], temperature), likelihood)
        one = glances[temperature].better(name, model.channels[name], price)
        floor = white_floor([run], name, block_of(run)).of_blocks([blocks])
        # What is missing of a model that leaves hardly more than the white noise is too small to matter.
        found.append(one if one is not None and one.before >= MATERIAL * floor.sd else None)
    return [one for one in found if one is not None]


@dataclass(frozen=True, eq=False)
class _Base:
    """What candidates are tried beside: the constants of a channel, and the curve where that is fitted anew.

    `levels` (n, k) and `powers` (n, degree) are the columns, `nothing` is the log-likelihood of the present
    model.
    """

    pool: Pool
    likelihood: Likelihood
    values: FloatArray
    levels: FloatArray
    powers: FloatArray
    nothing: float

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


class _Glance:
    """What is tried on channels that are over the same temperature."""

    def __init__(self, pool: Pool, likelihood: Likelihood) -> None:
        self._pool, self._likelihood = pool, likelihood
        self._blocks = pool.runs[0]
        seen = survey(pool.runs, pool.temperature, CUBIC, self._blocks.block_s)
        degree = CUBIC if seen.thermal else 0
        self._declared = Declared.over(pool.runs, pool.temperature, degree, "")
        self._turned = turned(pool.runs)
        self._survey = with_drivers(seen, pool.runs, pool.temperature)
        self._candidates = _simple(self._survey)

    def better(self, name: str, model: ChannelModel, price: float) -> Better | None:
        """Return a better model of a channel, if one is proven beyond what looking costs."""
        values = self._blocks.mean[name]
        levels = self._levels(values)
        leaders = self._leaders(values, levels)
        best = max(leaders.values(), key=_gain, default=None)
        if best is None or best.gain - price <= PROVEN:
            return None
        least = best.gain - max(CLOSE, CLOSE_SHARE * best.gain)
        near = [
            name for name in sorted(leaders, key=lambda n: -leaders[n].gain) if leaders[name].gain > least
        ]
        design = np.column_stack([best.base.columns, self._pool.design(best.effects)])
        coefficients = ordinary(design, values)
        left = values - design @ coefficients
        given = values - levels @ ordinary(levels, values)
        before, after = (float(np.sqrt(np.mean(part**2))) for part in (given, left))
        constant, rest = coefficients[: levels.shape[1]].mean(), coefficients[levels.shape[1] :]
        # What is left holds the white noise of the means as well: no smaller than it is.
        extended = self._extended(model, best, np.array([constant, *rest]), min(model.residual_sd, after))
        return Better(name, near, best.gain - price, before, after, extended)

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

    def _leaders(self, values: FloatArray, levels: FloatArray) -> dict[str, _Tried]:
        """Return the best of each effect; the most likely ones with their parameters refined."""
        nothing, noise = self._likelihood.best(values, levels)
        powers = self._declared.columns(self._blocks.temperature[self._pool.temperature])[:, 1:]
        found: list[_Tried] = []
        for degree in sorted({0, self._declared.degree}):
            base = _Base(self._pool, self._likelihood, values, levels, powers[:, :degree], nothing)
            short = families(base.scored(self._candidates, coarse_grid(noise)), SHORT_LIST).values()
            finely = base.scored([one.candidate for group in short for one in group], fine_grid(noise))
            found += [_Tried(one, base) for one in finely]
            if degree:
                found.append(_Tried(None, base))
        leaders = {one.name: one for one in sorted(found, key=_gain)}
        close = sorted(leaders.values(), key=_gain)[-MOST_CLOSE:]
        return leaders | {one.name: one.refined(self._survey) for one in close}

    def _extended(
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
