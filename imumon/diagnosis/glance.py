"""A glance at the session that is running: does a better model exist, by the likelihood of the diagnosis?

Each gyro by itself, one run from power-on, one effect at a time and a coarse grid of noise.  The whole
diagnosis tries more, and proves what it names on other data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import Polynomial

from imumon.blocks import FloatArray
from imumon.diagnosis.blocks import BLOCK_S, RunBlocks, make_blocks, survey, white_floor
from imumon.diagnosis.candidates import Candidate, Pool, candidates
from imumon.diagnosis.channel import Declared, ordinary
from imumon.diagnosis.drivers import recorded, with_drivers
from imumon.diagnosis.earth import ALLOWANCE, turned
from imumon.diagnosis.explaining import MATERIAL
from imumon.diagnosis.gains import CLOSE, CLOSE_SHARE, PROVEN
from imumon.diagnosis.known import CUBIC, temperature_of
from imumon.diagnosis.likelihood import Likelihood, coarse_grid
from imumon.diagnosis.recording import SECOND_NS, Run
from imumon.effects.base import Survey
from imumon.effects.library import EFFECTS
from imumon.effects.temperature_curve import TemperatureCurve
from imumon.geodesy import EARTH_RATE
from imumon.models.model import BiasModel, ChannelModel
from imumon.models.predictor import BiasPredictor

LEAST_BLOCKS = 40
"""As the whole diagnosis needs."""
MOST_SLOTS = 7200
"""Two hours of seconds: the whole diagnosis of such a run is a matter of some seconds, a glance of tenths."""
OWN = ("run", "event")
"""Scopes of what no model file can have."""
GRID = coarse_grid((0.0, 0.0), (1000.0, 1000.0))


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


def in_few_slots(run: Run) -> Run:
    """Return a run of seconds in longer slots where they are many: a look at it then costs no more."""
    width = -(-len(run.time_s) // MOST_SLOTS)
    if width <= 1:
        return run
    starts = np.arange(0, len(run.time_s), width)
    samples = next(iter(run.count.values()))

    def mean(values: FloatArray, weight: FloatArray) -> FloatArray:
        weight = np.where(np.isfinite(values), weight, 0.0)
        total = np.add.reduceat(np.where(weight > 0, values, 0.0) * weight, starts)
        with np.errstate(invalid="ignore"):
            return np.asarray(total / np.add.reduceat(weight, starts))

    return replace(
        run,
        time_s=(np.arange(len(starts), dtype=np.float64) + 0.5) * width * run.slot_s,
        count={name: np.add.reduceat(count, starts) for name, count in run.count.items()},
        mean={name: mean(values, run.count.get(name, samples)) for name, values in run.mean.items()},
        variance={name: np.full(len(starts), np.nan) for name in run.variance},
        rest=np.nan_to_num(mean(run.rest, samples)),
        slot_s=width * run.slot_s,
    )


def block_of(run: Run) -> float:
    """Return the length in seconds of the means that a run is looked at in: 30 s, of longer slots more."""
    return BLOCK_S * run.slot_s


def better_models(run: Run, model: BiasModel, channels: Sequence[str], looks: int = 1) -> list[Better]:
    """Return the better models of channels of which there are any.

    `looks` is how often this run has been looked at, with this time: each look at each channel may be fooled,
    so a gain pays twice the logarithm of their number, as in the extended BIC (Chen & Chen 2008).
    """
    temperatures = [temperature_of(name, model, [run]) for name in channels]
    blocks = residual(run, model, channels, recorded([run], [], temperatures, None, []), block_of(run))
    if len(blocks) < LEAST_BLOCKS:
        return []
    likelihood, glances = Likelihood([blocks], GRID), dict[str, _Glance]()
    found = []
    for name, temperature in zip(channels, temperatures, strict=True):
        if temperature not in glances:
            glances[temperature] = _Glance(Pool([blocks], temperature), likelihood)
        one = glances[temperature].better(name, model.channels[name], looks * len(channels))
        floor = white_floor([run], name, block_of(run)).of_blocks([blocks])
        # What is missing of a model that leaves hardly more than the white noise is too small to matter.
        found.append(one if one is not None and one.before >= MATERIAL * floor.sd else None)
    return [one for one in found if one is not None]


@dataclass(frozen=True, slots=True)
class _Tried:
    """A candidate with its gain over the present model; `curve` says whether the curve is fitted anew."""

    candidate: Candidate | None
    curve: bool
    gain: float
    name: str


class _Glance:
    """What is tried on channels that are over the same temperature."""

    def __init__(self, pool: Pool, likelihood: Likelihood) -> None:
        self._pool, self._likelihood = pool, likelihood
        self._blocks = pool.runs[0]
        seen = survey(pool.runs, pool.temperature, CUBIC, self._blocks.block_s)
        degree = CUBIC if seen.thermal else 0
        self._declared = Declared.over(pool.runs, pool.temperature, degree, "")
        self._turned = turned(pool.runs)
        self._few = _few(with_drivers(seen, pool.runs, pool.temperature), pool)
        self._terms = [pool.terms(candidate)[0] for candidate in self._few]

    def better(self, name: str, model: ChannelModel, looks: int) -> Better | None:
        """Return a better model of a channel, if one is proven."""
        values = self._blocks.mean[name]
        levels = self._levels(values)
        tried = self._tried(values, levels)
        best = max(tried, key=lambda one: one.gain, default=None)
        price = 2.0 * float(np.log(looks))
        if best is None or best.gain - price <= PROVEN:
            return None
        leaders: dict[str, float] = {}
        for one in tried:
            leaders[one.name] = max(one.gain, leaders.get(one.name, -np.inf))
        least = best.gain - max(CLOSE, CLOSE_SHARE * best.gain)
        near = [name for name in sorted(leaders, key=lambda n: -leaders[n]) if leaders[name] > least]
        base = np.column_stack([levels, self._curve(best.curve)])
        design = np.column_stack(
            [base, *([] if best.candidate is None else [self._pool.design([best.candidate])])]
        )
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

    def _tried(self, values: FloatArray, levels: FloatArray) -> list[_Tried]:
        price = self._likelihood.price
        nothing = self._best(values, levels)
        found = []
        for curve in (False, True) if self._declared.degree else (False,):
            powers = self._curve(curve)
            base, parameters = np.column_stack([levels, powers]), powers.shape[1]
            if curve:
                gain = 2 * (self._best(values, base) - nothing) - parameters * price
                found.append(_Tried(None, curve, gain, TemperatureCurve.name))
            likelihood, _ = self._likelihood.scan(values, base, self._pool, self._terms, GRID)
            for candidate, own, value in zip(self._few, self._terms, likelihood.tolist(), strict=True):
                cost = (parameters + len(own) + candidate.nonlinear) * price + candidate.choice
                found.append(_Tried(candidate, curve, 2 * (value - nothing) - cost, candidate.family))
        return found

    def _best(self, values: FloatArray, base: FloatArray) -> float:
        return self._likelihood.best(values, base)[0]

    def _curve(self, curve: bool) -> FloatArray:
        """Return the powers of a curve that is fitted anew, (n, degree); none of one that is not."""
        columns = self._declared.columns(self._blocks.temperature[self._pool.temperature])
        return columns[:, 1:] if curve else columns[:, :0]

    def _extended(
        self, model: ChannelModel, one: _Tried, coefficients: FloatArray, residual_sd: float
    ) -> ChannelModel:
        from imumon.diagnosis.extended import refitted

        split = self._declared.degree + 1 if one.curve else 1
        middle, half = self._declared.middle_degc, self._declared.half_span_degc
        more = Polynomial(coefficients[:split], domain=[middle - half, middle + half])
        effects = [effect for effect in model.effects if effect.polynomial() is None]
        if one.candidate is not None:
            effects.append(one.candidate.parts[0].effect.with_coefficients(coefficients[split:]))
        return refitted(model, more, effects, residual_sd)


def _few(seen: Survey, pool: Pool) -> list[Candidate]:
    """Return what may be in a model file; of neighbours on a grid one, where the gain of the other is no
    less than that of a shape which is not told from it."""
    found: list[Candidate] = []
    for candidate in candidates(seen, [name for name, kind in EFFECTS.items() if kind.scope not in OWN]):
        effect = candidate.parts[0].effect
        simple = getattr(effect, "order", 1) == 1 and not candidate.whole and not candidate.free_start
        if simple and len(candidate.parts) == 1:
            found.append(candidate)
    columns = pool.matrix([pool.terms(candidate)[0][0] for candidate in found])
    columns = columns - columns.mean(axis=0)
    columns /= np.maximum(np.linalg.norm(columns, axis=0), 1e-300)
    kept: list[int] = []
    for at, candidate in enumerate(found):
        before = kept[-1] if kept and found[kept[-1]].family == candidate.family else None
        alike = before is not None and (columns[:, before] @ columns[:, at]) ** 2 > 1.0 - CLOSE_SHARE
        if not alike or len(pool.terms(candidate)[0]) > 1:
            kept.append(at)
    return [found[at] for at in kept]
