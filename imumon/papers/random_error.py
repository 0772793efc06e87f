"""STF, SR-UKF and SR-RSUKF as a stage of the pipeline: random error of the gyros at rest, held in motion.

Shi Gang et al. start from parameters that they do not give.  Here R and δ¹ are those of a local level that is
fitted to the first minute at rest, or of the noise that the user knows.  Beside the filters stand an
exponential mean and a hold of the beginning: what any of them must beat.

The zero of the estimates is a rate of zero: they hold the turn-on bias, the drift since, and the earth's rate
along the axis, less the thermal bias of a model where there is one.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

from imumon.blocks import Columns, FloatArray, IntArray, SampleBlock
from imumon.columns import Column, vector_columns
from imumon.models.model import BiasModel
from imumon.run.setup import RandomErrorParameters

from .local_level import (
    LEAST_MEANS,
    SLOT_S,
    ExponentialMean,
    LocalLevel,
    RestMean,
    RestMeans,
    fit_local_level,
    from_noise,
    level_after,
)
from .shi_filters import LinearFilter, Model, SampleFilter, SigmaPointFilter
from .slot_stage import SlotStage, at_rest, gyro_predictor

AXES = "xyz"
LINEAR, RISK_SENSITIVE = "stf", "sr_rsukf"
TITLES = {LINEAR: "STF", "sr_ukf": "SR-UKF", RISK_SENSITIVE: "SR-RSUKF"}
PHI_VARIANCE = 0.01
"""Variance of φ at the start; nothing is known but that it is zero for a local level."""
SOFTENING = 1.0
"""β of STF."""
OTHER_RATE = 1.5
"""The filters start anew when the sampling interval has changed by this factor."""
QUANTITIES = (
    ("random_error", "rad/s", "random error"),
    ("random_error_sd", "rad/s", "standard deviation of the random error"),
    ("phi", "1", "φ"),
    ("phi_sd", "1", "standard deviation of φ"),
)
"""Columns of each method; those of φ where it is estimated."""
MEANS = (
    ("gyro_rest_mean", "exponential mean at rest"),
    ("gyro_rest_hold", "mean of the first seconds at rest, held"),
)

RISK, PHI_LIMIT = 0.5, 0.9
"""2 μ_x (R + q) of SR-RSUKF, and the limit that φ is held within: the paper gives neither."""


@dataclass
class Axis:
    """State of one axis."""

    noise: LocalLevel | None  # R and δ¹ per second; None until learnt
    mean: ExponentialMean
    hold: ExponentialMean
    means: list[RestMean] = field(default_factory=list)  # of the segment; of all while the noise is learnt
    covered_s: float = 0.0  # time at rest in `means`
    filters: dict[str, SampleFilter] = field(default_factory=dict)  # empty until they start
    interval_s: float = 0.0  # between the samples that they were started for

    def take(self, new: RestMean, methods: Sequence[str], learn_s: float) -> None:
        """Take in a second at rest: learn the noise, then start the filters where they do not run."""
        if new.begins and self.noise is not None:
            self.means.clear()
        if not self.filters or self.noise is None:
            self.means.append(new)
        self.covered_s += new.covered_s
        count = sum(mean.covered_s > 0.0 for mean in self.means)
        if self.noise is None and self.covered_s >= learn_s and count >= LEAST_MEANS:
            self.noise = fit_local_level(self.means)
            del self.means[: max(k for k, mean in enumerate(self.means) if mean.begins)]
        if self.noise is None or new.covered_s == 0.0:
            return
        if not self.filters:
            level, variance = level_after(self.means, self.noise)
            self.means.clear()
        elif 1.0 / OTHER_RATE < new.interval_s / self.interval_s < OTHER_RATE:
            return
        else:
            level, variance = new.mean, self.noise.white / new.covered_s
        self.interval_s = new.interval_s
        self.filters = {name: _begun(name, self.noise, level, variance, new.interval_s) for name in methods}


def _begun(method: str, local: LocalLevel, level: float, variance: float, interval_s: float) -> SampleFilter:
    """Return a filter that begins at a level in rad/s, with R and δ¹ of the noise; δ² = 0, φ = 0."""
    noise, process = local.white / interval_s, local.walk * interval_s
    delta1 = math.sqrt(process)
    # R bounds the start as well: a wide one would be over the limit of the risk.
    variance = min(variance, 0.5 * noise)
    model = Model((level, level, 0.0, delta1, 0.0), (variance, variance, PHI_VARIANCE, 0.0, 0.0), noise)
    if method == LINEAR:
        return LinearFilter(model, SOFTENING)
    mu = RISK / (2.0 * (noise + process)) if method == RISK_SENSITIVE else 0.0
    return SigmaPointFilter(model, mu, PHI_LIMIT)


class RandomErrorMethods(SlotStage):
    """The published filters of the random error, with the means that they must beat.

    Columns are ``{method}_random_error_{axis}`` and ``{method}_random_error_sd_{axis}`` in rad/s, φ as
    ``{method}_phi_{axis}`` with its standard deviation, and ``gyro_rest_mean`` and ``gyro_rest_hold``.

    `methods`: of `TITLES`.
    `given`: its noise is that of the axes that are not learnt.
    `model`: its bias is taken off before; axes that it lacks keep theirs.
    """

    def __init__(
        self,
        methods: Sequence[str],
        given: RandomErrorParameters,
        model: BiasModel | None = None,
    ) -> None:
        super().__init__(len(AXES), SLOT_S, len(MEANS) * len(AXES))
        self.methods, self._given = methods, given
        self._predictor, self._modelled = gyro_predictor(model)
        self._means = RestMeans()
        noise: dict[str, LocalLevel] = {
            channel: from_noise(one.angle_random_walk, one.bias_instability, one.rate_random_walk)
            for channel, one in self._given.noise.items()
        }
        mean_s, hold_s = self._given.mean_s, self._given.hold_s
        self._axes = {
            a: Axis(noise.get(f"gyro_{a}"), ExponentialMean(mean_s), ExponentialMean(math.inf, hold_s))
            for a in AXES
        }
        self._last_ns = 0

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds."""
        named = [
            (f"{method}_{name}", unit, f"{text} by {TITLES[method]}")
            for method in self.methods
            for name, unit, text in QUANTITIES[: 2 if method == LINEAR else 4]
        ]
        named += [(name, "rad/s", text) for name, text in MEANS]
        return [column for vector in named for column in vector_columns(*vector)]

    def process(self, block: SampleBlock) -> Columns:
        """Return the new columns of a block; NaN where there is no estimate.

        Needs ``device_time_ns`` and ``segment``; uses the gyros, ``at_rest``, and the temperatures of the
        model.
        """
        n, times = len(block), block["device_time_ns"]
        found = {column.name: np.full(n, np.nan) for column in self.columns}
        readings = self._readings(block)
        slots, breaks = self.slots(block, readings)
        rows, means = slots.row.tolist(), self._means.process(slots)
        steps_ns = np.diff(times, prepend=self._last_ns)
        shown = np.empty((len(means), len(MEANS) * len(AXES)))
        ends = [*((row, k) for k, row in enumerate(rows)), *((row, len(rows)) for row in breaks)]
        for j, (name, axis) in enumerate(self._axes.items()):
            at = 0
            for row, k in [*sorted(ends), (n, len(rows))]:
                if row > at:  # nothing begins in between
                    self._filter(name, slice(at, row), readings[at:row, j], steps_ns[at:row], found)
                at = row
                if k < len(rows):
                    axis.take(means[k][j], self.methods, self._given.learn_s)
                    shown[k, j :: len(AXES)] = axis.mean.step(means[k][j]), axis.hold.step(means[k][j])
                elif row < n:
                    axis.filters = {}
        values = self.spread(slots.row, shown, breaks, n)
        names = [f"{column}_{name}" for column, _ in MEANS for name in AXES]
        found |= dict(zip(names, values.T, strict=True))
        if n:
            self._last_ns = times[-1]
        return found

    def _filter(
        self,
        name: str,
        part: slice,
        readings: FloatArray,
        steps_ns: IntArray,
        found: Mapping[str, FloatArray],
    ) -> None:
        """Run the filters of an axis over rows within which nothing begins."""
        axis = self._axes[name]
        for method, one in axis.filters.items():
            series = one.process(readings, np.asarray(steps_ns * (1e-9 / axis.interval_s), np.float64))
            found[f"{method}_random_error_{name}"][part] = series.estimate
            found[f"{method}_random_error_sd_{name}"][part] = series.sd
            if method != LINEAR:
                found[f"{method}_phi_{name}"][part] = series.phi
                found[f"{method}_phi_sd_{name}"][part] = series.phi_sd

    def _readings(self, block: SampleBlock) -> FloatArray:
        """Return the rates less the thermal bias, (n, 3), NaN where the unit is not at rest."""
        readings = block.stacked([f"gyro_{axis}" for axis in AXES])
        readings[~at_rest(block, self._given.assume_rest)] = np.nan
        if self._predictor is not None:
            readings[:, self._modelled] -= self._predictor.of_block(block).bias
        return readings
