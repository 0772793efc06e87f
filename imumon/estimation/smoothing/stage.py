"""Temperature, gyro bias and heading at each time of a recording from earlier and later samples.

A `Recorder` keeps the forward run as means over short slots, `backward` runs the same stages over them with
time reversed, and `SmoothedEstimates` puts both together beside the samples, in a second run over the same
recording.  Reversed in time, a rotation by ω is one by -ω: rates and bias change their sign.

Each estimate is one from a forward and a backward filter (Fraser and Potter 1969).  If their errors are
independent, their difference has the variance P_f + P_b, and the weights are the inverse variances.  (Both
have the sample at t itself: where it alone decides, sigma is too small by the root of two.)

Let r be the rms over a recording of the normalised residual |f - b| / sqrt(P_f + P_b).  If it exceeds one,
the model lacks an effect.  All standard deviations are then multiplied by r, or by the median residual over
that of a normal one if that is smaller (scale factor of the Particle Data Group); where a single residual
exceeds two, by that residual, if it is more.
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.columns import TEMPERATURES, Column
from imumon.estimation.alignment.report import PositionHeading
from imumon.estimation.rest.slots import SENSORS
from imumon.filters.slots import SlotGatherer, Slots
from imumon.pipeline import Estimator

SLOT_NS = 31_250_000  # an eighth of the shortest slot over which a stage integrates rotations
SUSPECT = 2.0  # a standard normal value exceeds this in magnitude with a probability of 5 %
MEDIAN = 0.6745  # median of the magnitude of a standard normal value
REVERSED = {"temperature_estimate": 1.0, "temperature_rate": -1.0, "gyro_bias": -1.0}
"""What is smoothed with a backward filter, and its sign when time is reversed."""
UNITS = {"temperature_estimate": "degC", "temperature_rate": "degC/s", "gyro_bias": "rad/s", "heading": "rad"}
QUANTITIES = [(name, suffix) for name in REVERSED for suffix in ("", "_x", "_y", "_z")]
"""Names of columns: a quantity and of which thermometer or axis it is."""


def value_and_sd(quantity: str, suffix: str = "") -> tuple[str, str]:
    """Return the names of the columns of a quantity and of its standard deviation."""
    return f"{quantity}{suffix}", f"{quantity}_sd{suffix}"


NAMES = (
    *SENSORS,
    *TEMPERATURES,
    *(name for quantity in QUANTITIES for name in value_and_sd(*quantity)),
    *(f"gyro_random_error_{axis}" for axis in "xyz"),
    "attitude_estimate_heading",
    "heading",
)
"""Columns of a record."""


class Record(NamedTuple):
    """n slots of a recording, in order; arrays are (n,)."""

    stop: IntArray  # row of the recording after the last of each slot
    run: IntArray  # number of the segment, counted from restart to restart
    middle_ns: IntArray  # device time
    columns: SampleBlock  # means of sensors; last values of temperatures and estimates


class Recorder:
    """Averages the blocks of a run into slots; the result does not depend on the division into blocks."""

    def __init__(self) -> None:
        self._slots = SlotGatherer(len(NAMES), SLOT_NS)
        self._rows = 0
        self._parts: list[tuple[ColumnArray, ...]] = []

    def add(self, block: SampleBlock) -> None:
        """Take the next rows."""
        times, segment = block["device_time_ns"], block["segment"]
        self._keep(self._slots.process(times, segment, block.stacked(NAMES)))
        self._rows += len(block)

    def _keep(self, slots: Slots) -> None:
        """Keep copies: what the gatherer returns holds the memory of all its results."""
        values = np.hstack([slots.mean[:, : len(SENSORS)], slots.last[:, len(SENSORS) :]])
        self._parts.append((slots.row + self._rows, slots.begins.copy(), slots.middle_ns, values))

    def finish(self) -> Record:
        """Return the record of all rows."""
        self._keep(self._slots.finish())
        stop, begins, middle_ns, values = (np.concatenate(part) for part in zip(*self._parts, strict=True))
        columns = dict(zip(NAMES, np.ascontiguousarray(values.T), strict=True))
        return Record(stop, np.cumsum(begins), middle_ns, SampleBlock(columns))


def backward(record: Record, temperature: Estimator, bias: Estimator) -> dict[str, FloatArray]:
    """Return temperature, its rate and the bias, with their sigmas, by what comes later, (n,) each.

    The stages are new.  That of the bias has no bias model, nor its sigma: the modelled bias is subtracted
    from the rates here.  Time counts from the end of each run, and the order of the runs is reversed.
    """
    ends = np.flatnonzero(np.diff(record.run, append=-1))
    last_ns = record.middle_ns[ends][np.searchsorted(record.run[ends], record.run)]
    # The modelled bias: zero without a model, NaN while it is not known.
    model = np.column_stack(
        [record.columns[f"gyro_bias_{axis}"] - record.columns[f"gyro_random_error_{axis}"] for axis in "xyz"]
    )
    modelled = (np.nan_to_num(model) != 0.0).any(0)
    model = np.where(np.isfinite(model) | modelled, model, 0.0)
    present = [name for name in TEMPERATURES if np.isfinite(record.columns[name]).any()]
    columns: dict[str, ColumnArray] = {
        "device_time_ns": last_ns - record.middle_ns,
        "segment": record.run.max(initial=0) - record.run,
        **{name: record.columns[name] for name in (*SENSORS[3:], *present)},
        **{name: of_axis - record.columns[name] for name, of_axis in zip(SENSORS[:3], model.T, strict=True)},
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


class Smoothed(NamedTuple):
    """Estimate and standard deviation, (n,) each, and r as above."""

    value: FloatArray
    sd: FloatArray
    residual: float


def combine(
    forward: FloatArray, forward_sd: FloatArray, backward: FloatArray, backward_sd: FloatArray
) -> Smoothed:
    """Return the estimate from both directions, (n,); the only one where there is one; NaN where none."""
    both = np.isfinite(forward + forward_sd + backward + backward_sd)
    has_forward = np.isfinite(forward_sd)
    value, sd = np.where(has_forward, forward, backward), np.where(has_forward, forward_sd, backward_sd)
    if not both.any():
        return Smoothed(value, sd, np.nan)
    p_f, p_b = forward_sd[both] ** 2, backward_sd[both] ** 2
    residual = np.abs(forward - backward)[both] / np.sqrt(p_f + p_b)
    r = float(np.sqrt(np.mean(residual**2)))
    weight = p_b / (p_f + p_b)
    value[both] = weight * forward[both] + (1.0 - weight) * backward[both]
    usual = max(min(r, float(np.median(residual)) / MEDIAN), 1.0)
    sd *= usual  # also where there is one direction
    sd[both] = np.sqrt(weight * p_f) * np.where(residual > SUSPECT, np.maximum(residual, usual), usual)
    return Smoothed(value, sd, r)


def still_heading(record: Record, positions: Sequence[PositionHeading]) -> Smoothed:
    """Return the heading of each slot in which the unit stood still, rad, (n,); NaN elsewhere.

    It is a constant, so it is the result of one fit to all samples of the interval, as the alignment of the
    whole recording left it.  Warm-up and a settling tripod are models that only run forward.
    """
    value, sd = np.full((2, len(record.run)), np.nan)
    for position in positions:
        run = np.flatnonzero(record.run == position.run)
        since_s = 1e-9 * (record.middle_ns[run] - record.middle_ns[run[:1]])
        rows = run[(since_s >= position.begun_s) & (since_s <= position.ended_s)]
        value[rows], sd[rows] = position.heading, position.sd
    return Smoothed(value, sd, np.nan)


class SmoothedEstimates:
    """Estimates from forward and backward filters; ``gyro_bias_sd_x`` becomes ``gyro_bias_smoothed_sd_x``.

    `record` is of the first run; `backward`, (n,) each, and `heading` are by `backward` and `still_heading`.
    """

    def __init__(
        self, record: Record, backward: Mapping[str, FloatArray], heading: Smoothed | None = None
    ) -> None:
        self._stop, self._rows = record.stop, 0
        self._values: dict[str, FloatArray] = {}
        self.residuals: dict[str, float] = {}  # r of `combine`, by quantity
        self.columns: tuple[Column, ...] = ()
        found = {}
        for quantity in QUANTITIES:
            names = value_and_sd(*quantity)
            if names[0] in backward:
                found[quantity] = combine(*(of[name] for of in (record.columns, backward) for name in names))
        if heading is not None:
            found["heading", ""] = heading
        for (name, suffix), one in found.items():
            if np.isfinite(one.residual):
                self.residuals[f"{name}{suffix}"] = one.residual
            if np.isfinite(one.sd).any():
                value, sd = value_and_sd(f"{name}_smoothed", suffix)
                self._values |= {value: one.value, sd: one.sd}
                self.columns += (
                    Column(value, UNITS[name], description="with what came later"),
                    Column(sd, UNITS[name], description="standard deviation with what came later"),
                )

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the new columns of a block; the blocks must be the rows of the first run, in their order."""
        rows = np.arange(self._rows, self._rows + len(block))
        self._rows += len(block)
        slot = np.minimum(np.searchsorted(self._stop, rows, side="right"), max(len(self._stop) - 1, 0))
        return {name: values[slot] for name, values in self._values.items()}

    def notices(self) -> list[str]:
        """Return the quantities in which forward and backward contradict each other."""
        contradict = [f"{name} ({r:.1f} σ)" for name, r in self.residuals.items() if r > SUSPECT]
        return [
            f"forward and backward contradict each other in {', '.join(contradict)}: something changed "
            "abruptly that the filter takes for smooth, or its model lacks an effect (of a bias, imumon "
            "diagnose may name it); the smoothed sigma is widened by that"
        ] * bool(contradict)
