"""STF, SR-UKF and SR-RSUKF as a stage of the pipeline: random error of the gyros at rest, held in motion.

Shi Gang et al. start from parameters that they do not give.  Here R and δ¹ are those of a local level that is
fitted to the first minute at rest, or of the noise that the user knows.  Beside the filters stand an
exponential mean and a hold of the beginning: what any of them must beat.

The zero of the estimates is a rate of zero: they hold the turn-on bias, the drift since, and the earth's rate
along the axis, less the thermal bias of a model where there is one.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import NO_INT, BoolArray, ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.columns import Column
from imumon.filters.slots import SlotGatherer
from imumon.models.model import BiasModel
from imumon.models.predictor import BiasPredictor
from imumon.papers.linear import LinearFilter, ModelL
from imumon.papers.local_level import LEAST_MEANS, LocalLevel, fit_local_level, from_noise, level_after
from imumon.papers.rest_means import SLOT_S, ExponentialMean, RestMean, RestMeans, hold
from imumon.papers.shown import Shown
from imumon.papers.sigma_points import FilterSeries, ModelNL, SigmaPointFilter
from imumon.run.paper_parameters import RandomErrorParameters

AXES = "xyz"
LINEAR, UNSCENTED, RISK_SENSITIVE = "stf", "sr_ukf", "sr_rsukf"
METHODS = (LINEAR, UNSCENTED, RISK_SENSITIVE)
TITLES = {LINEAR: "STF", UNSCENTED: "SR-UKF", RISK_SENSITIVE: "SR-RSUKF"}
PHI_VARIANCE = 0.01
"""Variance of φ at the start; nothing is known but that it is zero for a local level."""
SOFTENING = 1.0
"""β of STF."""
OTHER_RATE = 1.5
"""The filters start anew when the sampling interval has changed by this factor."""
MEANS = (
    ("gyro_rest_mean", "exponential mean at rest"),
    ("gyro_rest_hold", "mean of the first seconds at rest, held"),
)

Filter = LinearFilter | SigmaPointFilter


@dataclass
class Axis:
    """State of one axis."""

    noise: LocalLevel | None
    """R and δ¹ per second; None until learnt."""
    mean: ExponentialMean
    hold: ExponentialMean
    means: list[RestMean] = field(default_factory=list)
    """Those of the segment, and while the noise is being learnt all so far."""
    covered_s: float = 0.0
    """Time at rest in `means`."""
    filters: dict[str, Filter] = field(default_factory=dict)
    """Empty until they start."""
    interval_s: float = 0.0
    """Between the samples that they were started for."""
    shrunk: int = 0
    clamped: int = 0

    def stop(self) -> None:
        """Give up the filters, but not how often they strained."""
        for one in self.filters.values():
            if isinstance(one, SigmaPointFilter):
                self.shrunk += one.shrunk_steps
                self.clamped += one.clamped_steps
        self.filters = {}


def take(axis: Axis, new: RestMean, methods: Sequence[str], given: RandomErrorParameters) -> None:
    """Take in a second at rest: learn the noise, then start the filters where they do not run."""
    if new.begins and axis.noise is not None:
        axis.means.clear()
    if not axis.filters or axis.noise is None:
        axis.means.append(new)
    axis.covered_s += new.covered_s
    if axis.noise is None and axis.covered_s >= max(given.learn_s, LEAST_MEANS):
        axis.noise = fit_local_level(axis.means).expected
        last = max(k for k, mean in enumerate(axis.means) if mean.begins)
        del axis.means[:last]
    if axis.noise is None or new.covered_s == 0.0:
        return
    if not axis.filters:
        start(axis, *level_after(axis.means, axis.noise), new.interval_s, methods, given)
        axis.means.clear()
    elif not 1.0 / OTHER_RATE < new.interval_s / axis.interval_s < OTHER_RATE:
        axis.stop()
        start(axis, new.mean, axis.noise.white / new.covered_s, new.interval_s, methods, given)


def start(
    axis: Axis,
    level: float,
    variance: float,
    interval_s: float,
    methods: Sequence[str],
    given: RandomErrorParameters,
) -> None:
    """Begin the filters at a level in rad/s, with R and δ¹ of the noise; δ² = 0, φ = 0."""
    assert axis.noise is not None
    noise, process = axis.noise.noise_variance(interval_s), axis.noise.process_variance(interval_s)
    delta1 = math.sqrt(process)
    # R bounds the start as well: a wide one would be over the limit of the risk.
    variance = min(variance, 0.5 * noise)
    axis.interval_s = interval_s
    mu = given.risk / (2.0 * (noise + process))
    model = ModelNL((level, level, 0.0, delta1, 0.0), (variance, variance, PHI_VARIANCE, 0.0, 0.0), noise)
    for method in methods:
        if method == LINEAR:
            linear = ModelL(0.0, delta1, 0.0, (level, level), (variance, variance), noise)
            axis.filters[method] = LinearFilter(linear, SOFTENING)
        else:
            risk = mu if method == RISK_SENSITIVE else 0.0
            axis.filters[method] = SigmaPointFilter(model, (risk, 0.0, 0.0, 0.0, 0.0), given.phi_limit)


class RandomErrorMethods:
    """The published filters of the random error, with the means that they must beat.

    Columns are ``{method}_random_error_{axis}`` and ``{method}_random_error_sd_{axis}`` in rad/s, φ as
    ``{method}_phi_{axis}`` with its standard deviation, and ``gyro_rest_mean`` and ``gyro_rest_hold``.

    Parameters
    ----------
    methods : sequence of str
        Of `METHODS`.
    given : RandomErrorParameters, optional
        Its noise is that of the axes that are not learnt.
    model : BiasModel, optional
        Its bias is taken off before; axes that it lacks keep theirs.
    """

    def __init__(
        self,
        methods: Sequence[str] = METHODS,
        given: RandomErrorParameters | None = None,
        model: BiasModel | None = None,
    ) -> None:
        self.methods, self._given = methods, given or RandomErrorParameters()
        names = [f"gyro_{a}" for a in AXES if model is not None and f"gyro_{a}" in model.channels]
        self._predictor = BiasPredictor(model, names) if model is not None and names else None
        self._modelled = names
        self._gatherer = SlotGatherer(len(AXES), round(SLOT_S * 1e9))
        self._means = RestMeans()
        noise: dict[str, LocalLevel] = {
            channel: from_noise(one.angle_random_walk, one.bias_instability, one.rate_random_walk)
            for channel, one in self._given.noise.items()
        }
        self._axes = {
            axis: Axis(
                noise.get(f"gyro_{axis}"), ExponentialMean(self._given.mean_s), hold(self._given.hold_s)
            )
            for axis in AXES
        }
        self._shown = Shown((len(MEANS), len(AXES)))
        self._last_ns: int | None = None
        self._reported: set[str] = set()

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds."""
        found = []
        for method in self.methods:
            title = TITLES[method]
            texts = [
                ("random_error", "rad/s", f"random error by {title}"),
                ("random_error_sd", "rad/s", "its standard deviation"),
            ]
            if method != LINEAR:
                texts += [("phi", "1", f"φ of {title}"), ("phi_sd", "1", "its standard deviation")]
            for name, unit, text in texts:
                found += [Column(f"{method}_{name}_{a}", unit, description=f"{text}, {a}") for a in AXES]
        return found + [
            Column(f"{name}_{a}", "rad/s", description=f"{text}, {a}") for name, text in MEANS for a in AXES
        ]

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the new columns of a block; NaN where there is no estimate.

        Needs ``device_time_ns`` and ``segment``; uses the gyros, ``at_rest``, and the temperatures of the
        model.
        """
        n, times, segment = len(block), block["device_time_ns"], block["segment"]
        found = {column.name: np.full(n, np.nan) for column in self.columns}
        readings = self._readings(block)
        slots = self._gatherer.process(times, segment, readings)
        rows, means = slots.row.tolist(), self._means.process(slots)
        breaks = self._shown.breaks(block)
        steps_ns = np.diff(times, prepend=times[:1] if self._last_ns is None else self._last_ns)
        shown = np.empty((len(means), len(MEANS), len(AXES)))
        for j, (name, axis) in enumerate(self._axes.items()):
            at = 0
            for row, k in sorted([(row, k) for k, row in enumerate(rows)] + [(b, len(rows)) for b in breaks]):
                self._filter(axis, name, slice(at, row), readings[:, j], steps_ns, found)
                at = row
                if k < len(rows):
                    take(axis, means[k][j], self.methods, self._given)
                    shown[k, :, j] = axis.mean.step(means[k][j]), axis.hold.step(means[k][j])
                else:
                    axis.stop()
            self._filter(axis, name, slice(at, n), readings[:, j], steps_ns, found)
        values = self._shown.spread(slots.row, shown, breaks, n)
        for i, (column, _) in enumerate(MEANS):
            for j, name in enumerate(AXES):
                found[f"{column}_{name}"] = values[:, i, j]
        if n:
            self._last_ns = int(times[-1])
        return found

    def _filter(
        self,
        axis: Axis,
        name: str,
        part: slice,
        readings: FloatArray,
        steps_ns: IntArray,
        found: Mapping[str, FloatArray],
    ) -> None:
        """Run the filters of an axis over rows within which nothing begins."""
        if part.stop <= part.start:
            return
        for method, one in axis.filters.items():
            steps = np.asarray(steps_ns[part] * (1e-9 / axis.interval_s), np.float64)
            series = one.process(readings[part], steps)
            found[f"{method}_random_error_{name}"][part] = series.estimate
            found[f"{method}_random_error_sd_{name}"][part] = series.sd
            if isinstance(series, FilterSeries):
                found[f"{method}_phi_{name}"][part] = series.phi
                found[f"{method}_phi_sd_{name}"][part] = series.phi_sd

    def _readings(self, block: SampleBlock) -> FloatArray:
        """Return the rates less the thermal bias, (n, 3), NaN where the unit is not at rest."""
        readings = np.full((len(block), len(AXES)), np.nan)
        for j, axis in enumerate(AXES):
            if f"gyro_{axis}" in block:
                readings[:, j] = block[f"gyro_{axis}"]
        readings[~self._rest(block)] = np.nan
        if self._predictor is not None:
            columns = self._predictor.temperature_columns
            temperature = np.full((len(block), len(columns)), np.nan)
            for j, name in enumerate(columns):
                if name in block:
                    temperature[:, j] = block[name]
            times, segment = block["device_time_ns"], block["segment"]
            others = {name: block[name] for name in self._predictor.drivers if name in block}
            bias = self._predictor.process(times, segment, temperature, others=others).bias
            readings[:, [AXES.index(name[-1]) for name in self._modelled]] -= bias
        return readings

    def _rest(self, block: SampleBlock) -> BoolArray:
        if "at_rest" in block:
            known = block["at_rest"]
            return np.asarray((known != 0) & (known != NO_INT))
        return np.full(len(block), self._given.assume_rest)

    def notices(self) -> list[str]:
        """Return, once each, where the filters strained."""
        found = {}
        for name, axis in self._axes.items():
            running = [one for one in axis.filters.values() if isinstance(one, SigmaPointFilter)]
            shrunk = axis.shrunk + sum(one.shrunk_steps for one in running)
            clamped = axis.clamped + sum(one.clamped_steps for one in running)
            if shrunk:
                found[f"{name} risk"] = (
                    f"random error of gyro {name}: SR-RSUKF: the risk was over its limit and was made "
                    f"smaller ({shrunk} steps so far)"
                )
            if clamped:
                limit = self._given.phi_limit
                found[f"{name} phi"] = (
                    f"random error of gyro {name}: φ of model NL went to ±{limit:g} and was held back "
                    f"({clamped} steps so far): the model does not fit, or the unit moved unnoticed"
                )
        new = [text for key, text in found.items() if key not in self._reported]
        self._reported |= found.keys()
        return new


class InsteadOfDefault:
    """One published random error under the names of the default one, as ``random_error: {method: ...}`` asks.

    ``gyro_random_error`` is that of the method, ``gyro_drift`` what the default stage said, ``gyro_phi`` that
    of the method.

    Parameters
    ----------
    methods : RandomErrorMethods
        With one method, on model NL.
    """

    def __init__(self, methods: RandomErrorMethods) -> None:
        self._methods = methods
        (prefix,) = methods.methods
        self._names = {
            f"{prefix}_{there}": here
            for there, here in (
                ("random_error", "gyro_random_error"),
                ("random_error_sd", "gyro_random_error_sd"),
                ("phi", "gyro_phi"),
                ("phi_sd", "gyro_phi_sd"),
            )
        }

    def _named(self, name: str) -> str:
        return f"{self._names.get(name[:-2], name[:-2])}{name[-2:]}"

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds, but for those that the default stage has, too."""
        own = [
            Column(self._named(column.name), column.unit, description=column.description)
            for column in self._methods.columns
            if "_random_error_" not in column.name
        ]
        texts = (("gyro_drift", "the default random error"), ("gyro_drift_sd", "its standard deviation"))
        return own + [
            Column(f"{name}_{a}", "rad/s", description=f"{text}, {a}") for name, text in texts for a in AXES
        ]

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the columns, those of the default stage anew."""
        found = {self._named(name): values for name, values in self._methods.process(block).items()}
        for a in AXES:
            for part in ("", "_sd"):
                found[f"gyro_drift{part}_{a}"] = block[f"gyro_random_error{part}_{a}"]
        return found

    def notices(self) -> list[str]:
        """Return the notices of the method."""
        return self._methods.notices()
