"""A glance at the session that is running: does a better model exist, by the likelihood of the diagnosis?

Each gyro by itself, one run from power-on, few candidates and a coarse grid of noise: some milliseconds.
The whole diagnosis takes seconds, tries more, and proves what it names on other data.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.polynomial import Polynomial

from imumon.blocks import FloatArray
from imumon.diagnosis.blocks import BLOCK_S, RunBlocks, make_blocks, survey
from imumon.diagnosis.candidates import Candidate, Part, Pool
from imumon.diagnosis.channel import Declared, ordinary
from imumon.diagnosis.gains import CLOSE, PROVEN
from imumon.diagnosis.known import CUBIC, temperature_of
from imumon.diagnosis.likelihood import Likelihood, coarse_grid
from imumon.diagnosis.recording import SECOND_NS, Run
from imumon.effects.base import Survey
from imumon.effects.library import EFFECTS
from imumon.effects.temperature_curve import TemperatureCurve
from imumon.models.model import BiasModel, ChannelModel
from imumon.models.predictor import BiasPredictor

LEAST_BLOCKS = 40
"""As the whole diagnosis needs."""
MOST = 6
"""Of the grid of an effect so many are tried, spread over it: their neighbours have a gain nearly as good."""
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
        rms of means of 30 s with the present model and a constant, and with the better one.
    model : ChannelModel
    """

    channel: str
    names: list[str]
    gain: float
    before: float
    after: float
    model: ChannelModel


def residual(run: Run, model: BiasModel, channels: Sequence[str]) -> RunBlocks:
    """Return means of 30 s of what a model leaves of the channels, effects carried along from power-on."""
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
    return make_blocks(left, channels, list(dict.fromkeys(temperatures.values())), block_s=BLOCK_S)


def better_models(run: Run, model: BiasModel, channels: Sequence[str], looks: int = 1) -> list[Better]:
    """Return the better models of channels of which there are any.

    `looks` is how often this run has been looked at, with this time: each look at each channel may be fooled,
    so a gain pays twice the logarithm of their number, as in the extended BIC (Chen & Chen 2008).
    """
    blocks = residual(run, model, channels)
    if len(blocks) < LEAST_BLOCKS:
        return []
    likelihood, glances = Likelihood([blocks], GRID), dict[str, _Glance]()
    found = []
    for name in channels:
        temperature = temperature_of(name, model, [run])
        if temperature not in glances:
            glances[temperature] = _Glance(Pool([blocks], temperature), likelihood)
        found.append(glances[temperature].better(name, model.channels[name], looks * len(channels)))
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
        seen = survey(pool.runs, pool.temperature, CUBIC, BLOCK_S)
        degree = CUBIC if seen.thermal else 0
        self._declared = Declared.over(pool.runs, pool.temperature, degree, "")
        self._few = _few(seen)
        self._terms = [pool.terms(candidate)[0] for candidate in self._few]

    def better(self, name: str, model: ChannelModel, looks: int) -> Better | None:
        """Return a better model of a channel, if one is proven."""
        values = self._blocks.mean[name]
        tried = self._tried(values)
        best = max(tried, key=lambda one: one.gain, default=None)
        price = 2.0 * float(np.log(looks))
        if best is None or best.gain - price <= PROVEN:
            return None
        leaders: dict[str, float] = {}
        for one in tried:
            leaders[one.name] = max(one.gain, leaders.get(one.name, -np.inf))
        near = [
            name for name in sorted(leaders, key=lambda n: -leaders[n]) if leaders[name] > best.gain - CLOSE
        ]
        design = self._design(best)
        coefficients = ordinary(design, values)
        left = values - design @ coefficients
        before, after = float(values.std()), float(np.sqrt(np.mean(left**2)))
        # What is left holds the white noise of the means as well: no smaller than it is.
        extended = self._extended(model, best, coefficients, min(model.residual_sd, after))
        return Better(name, near, best.gain - price, before, after, extended)

    def _tried(self, values: FloatArray) -> list[_Tried]:
        price = self._likelihood.price
        constant = self._base(curve=False)
        nothing = self._best(values, constant)
        found = []
        for curve in (False, True) if self._declared.degree else (False,):
            base = self._base(curve)
            parameters = base.shape[1] - 1
            if curve:
                gain = 2 * (self._best(values, base) - nothing) - parameters * price
                found.append(_Tried(None, curve, gain, TemperatureCurve.name))
            likelihood, _ = self._likelihood.scan(values, base, self._pool, self._terms, GRID)
            for candidate, own, value in zip(self._few, self._terms, likelihood.tolist(), strict=True):
                cost = (parameters + len(own) + candidate.nonlinear) * price
                found.append(_Tried(candidate, curve, 2 * (value - nothing) - cost, candidate.family))
        return found

    def _best(self, values: FloatArray, base: FloatArray) -> float:
        return self._likelihood.best(values, base)[0]

    def _base(self, curve: bool) -> FloatArray:
        columns = self._declared.columns(self._blocks.temperature[self._pool.temperature])
        return columns if curve else columns[:, :1]

    def _design(self, one: _Tried) -> FloatArray:
        more = [] if one.candidate is None else [self._pool.design([one.candidate])]
        return np.column_stack([self._base(one.curve), *more])

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


def _few(seen: Survey) -> list[Candidate]:
    """Return what may be in a model file, of each effect some that are spread over its grid."""
    found: list[Candidate] = []
    for family in EFFECTS.values():
        if family.scope in ("run", "event"):
            continue
        grid = [effect for effect in family.grid(seen) if not effect.is_curve and effect.width <= 3]
        simple = [effect for effect in grid if getattr(effect, "order", 1) == 1]
        spread = np.unique(np.linspace(0, len(simple) - 1, min(MOST, len(simple))).round().astype(int))
        found += [Candidate(simple[at].label, (Part(simple[at]),)) for at in spread.tolist()]
    return found
