"""The diagnosis of the session that is running, as a stage behind the bias filter.

A better model is found by the search and proven on what comes later: both models predict each block mean from
those before it, with the noise that each had when the better one was found.  Were the present model right,
the ratio of the two likelihoods would ever exceed A with a probability of 1 / A at most (Ville's inequality).
"""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from imumon.blocks import ColumnArray, SampleBlock
from imumon.charts import AXIS_COLORS, Axis, Chart, Curve
from imumon.columns import Column
from imumon.effects.library import EFFECTS
from imumon.effects.vibration import SECOND_NS
from imumon.errors import ImumonError
from imumon.geodesy import DEG_PER_H
from imumon.lane import LaneState, Level
from imumon.models.model import BiasModel, ChannelModel, TrainedOn
from imumon.models.predictor import BiasPredictor
from imumon.recordings.reduced import ACCEL, GYRO, KeptSlots, gatherer_of, kept_slots

from . import prepare
from .blocks import LEAST_BLOCKS, common_block_s, make_blocks, survey
from .candidates import Training
from .claims import CLEAN_RESIDUAL
from .diagnose import Prepared, likeliest, search_sensor
from .extended import refitted, trained_on, without_unknown_constant
from .fit import LEAST_TEST_BLOCKS, fit
from .likelihood import Likelihood
from .runs import DRIVERS, LONGEST_GAP_S, BoundedRun, Names, Origin, Run, further_columns
from .search import AxisSearch, gain_bar

# The first search has forty means of 30 s, the least that a diagnosis needs; the next ones follow at even
# distances (assumed), so that nothing stays unnoticed for longer than that.
FIRST_SEARCH_S, SEARCH_EVERY_S = 1200.0, 600.0
# Logarithm of the likelihood ratio (half a gain in BIC) by which a model wins: 1 in 3000 by chance.
DECISIVE = 8.0
# Effects that a model file can have.
LASTING = [name for name, kind in EFFECTS.items() if kind.scope not in ("run", "event")]


class Better(NamedTuple):
    """A better model of a channel."""

    channel: str
    names: list[str]  # effects of which the present model lacks one, not separated, the best first
    gain: float  # in BIC over the present model, of all channels that lack an effect
    before: float  # rms of the block means with the present model and a constant
    after: float  # with the better model
    model: ChannelModel


def better_models(run: Run, model: BiasModel, channels: Names) -> list[Better]:
    """Return a better model of each channel that lacks an effect.

    It is searched from the present model.  At most one effect of each channel is named, where the gain over
    that model, of all channels that lack one, pays for choosing effect, channels and curve (extended BIC).
    """
    temperatures = {name: prepare.temperature_of(name, model, [run]) for name in channels}
    used = list(dict.fromkeys(temperatures.values()))
    effects = [effect for name in channels for effect in model.channels[name].effects]
    drivers = prepare.usable_drivers([run], [], used, None, effects, [])
    left = prepare.without_curves(run, model, channels)
    in_blocks = make_blocks(left, channels, used, drivers, common_block_s([run]))
    if len(in_blocks) < LEAST_BLOCKS:
        return []
    degree = prepare.CUBIC_DEGREE if survey([in_blocks], used, 0).thermal else 0
    data = Prepared([in_blocks], temperatures, degree, model=model)
    searched = search_sensor(data, channels, LASTING, stages=1)
    axes = likeliest(searched, live=True)
    bases = {every[0].channel.offset_per for every in searched}
    if axes[0].channel.offset_per == "pose" and len(bases) > 1:
        return []  # it may be the earth rate: `imumon diagnose` has more sessions to decide
    improved = [axis for axis in axes if any(not finding.of_present_model for finding in axis.findings)]
    # Not searched, but for their S: the present model as it is.
    present = [AxisSearch(one.channel.with_model_fixed(), one.survey, one.likelihood, []) for one in improved]
    gain = sum(axis.criterion(axis.model) for axis in improved) - sum(axis.criterion([]) for axis in present)
    # With a curve it was chosen among two bases as well: the present curve and that fitted anew.
    if not gain > gain_bar(len(LASTING) * (2 if degree else 1), len(channels)):
        return []
    better = {axis: _better(axis, gain, model) for axis in improved}
    # What a model leaves hardly above the white noise is too small to matter.
    return [new for axis, new in better.items() if new.before >= CLEAN_RESIDUAL * axis.channel.floor.sd]


def _better(axis: AxisSearch, gain: float, model: BiasModel) -> Better:
    channel, present = axis.channel, model.channels[axis.channel.name]
    added = next(one for one in axis.findings if not one.of_present_model)
    before, fitted = fit(channel.with_model_fixed(), []), fit(channel, axis.model)
    # What is left holds the white noise of the means as well: the model's own error is no larger.
    lasting = without_unknown_constant(fitted, channel.name, model)
    better = refitted(present, channel, lasting, min(present.residual_sd, fitted.train_rms))
    return Better(channel.name, added.names, gain, before.train_rms, fitted.train_rms, better)


class Challenger(NamedTuple):
    """A better model of some channels that runs beside the present one since it was found."""

    present: BiasModel
    found: Sequence[Better]
    since_s: float  # time since power-on at which it was found

    @property
    def model(self) -> BiasModel:
        """The present one with the better channels."""
        channels = self.present.channels | {better.channel: better.model for better in self.found}
        return self.present.model_copy(update={"channels": channels})

    def compare(self, run: Run) -> tuple[float, float, float] | None:
        """Return how both models do on the part of a run that came later; None while that is too short.

        That is the logarithm of the likelihood ratio, the better model's over the present one's, and the rms
        that the present and the better model leave, over the channels that differ.  Temperatures outside
        those of the earlier part, from which the better model is, do not count.
        """
        names = [better.channel for better in self.found]
        run = prepare.within_range(self.model, run, names, self.since_s)
        logliks, squares = [], []
        for model in (self.present, self.model):
            left = prepare.residual_blocks(run, model, names)
            early = left.time_s < self.since_s
            if min(early.sum(), (~early).sum()) < LEAST_TEST_BLOCKS:
                return None
            residuals = [left.mean[name] - left.mean[name][early].mean() for name in names]
            # Without a column of an effect the temperature does not matter.
            likelihood = Likelihood(Training([left], "temperature"))
            logliks.append(sum(likelihood.predictive(residual, early) for residual in residuals))
            squares.append(np.mean([residual[~early] ** 2 for residual in residuals]))
        before, after = np.sqrt(squares).tolist()
        return logliks[1] - logliks[0], before, after


class LiveDiagnosis:
    """Reports when a better model than the present one exists: MODEL CAN BE BETTER, with effect and error.

    The gyros of the present model are searched 20 min after power-on, and every 10 min from then on.  With
    `learn` a better model then runs beside it, and is offered after it has won on what came later.  `made`
    returns the columns that other stages make: they drive nothing.
    """

    columns: Sequence[Column] = ()

    def __init__(
        self, model: BiasModel, learn: bool = False, made: Callable[[], Collection[str]] = tuple
    ) -> None:
        self._model, self._learn, self._made = model, learn, made
        self._gyros = [name for name in GYRO if name in model.channels]
        needed = BiasPredictor(model, self._gyros)
        temperatures = [name.replace("_estimate", "") for name in needed.temperature_columns]
        self._needed = [*self._gyros, *temperatures, "temperature", *needed.drivers]
        self._names: list[str] = []
        self._waiting: list[SampleBlock] = []
        self._pending: list[str] = []
        self._reported: set[str] = set()
        self._last_ns = 0
        # The better model that has won on the run `_won_on`, to be kept when the session ends.
        self.offered: Challenger | None = None
        self._begin()

    def _begin(self) -> None:
        """Begin with a run from power-on; a challenger that has not won yet is of another."""
        self._run_so_far = BoundedRun(self._names)
        self._next_search_s = FIRST_SEARCH_S
        self._challenger: Challenger | None = None
        self._charts: list[Chart] = []
        self.state = ""

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Take samples; needs ``device_time_ns``, ``segment``, gyros and temperature, takes ``at_rest``."""
        if len(block) and self._gyros and all(name in block for name in self._gyros):
            self._waiting.append(block)
            since = int(self._waiting[0]["device_time_ns"][0])
            # Short blocks wait, so that they cost no more than long ones.
            if not 0 <= int(block["device_time_ns"][-1]) - since < 10 * SECOND_NS:
                self._reduce()
        return {}

    def _reduce(self) -> None:
        if not self._names:
            there = [name for name in (*ACCEL, *DRIVERS) if any(name in block for block in self._waiting)]
            made = self._made()
            more = [name for block in self._waiting for name in further_columns(block, made)]
            self._names = [*dict.fromkeys([*self._needed, *there, *more])]
            self._gatherer = gatherer_of(self._names, 1.0)
        for block in self._waiting:
            for slots in kept_slots(self._gatherer, block, self._names):
                self._take(slots)
        self._waiting = []

    def _take(self, slots: KeptSlots) -> None:
        """Take the seconds that have ended, and search where due; a segment or a long gap begins a run."""
        for second in (slots[at : at + 1] for at in range(len(slots))):
            gap_ns = int(second.start_ns[0]) - self._last_ns
            self._last_ns = int(second.end_ns[0])
            if second.begins[0] or gap_ns > LONGEST_GAP_S * SECOND_NS:
                self._begin()
            now_s = self._run_so_far.take(second)
            if now_s >= self._next_search_s:
                self._next_search_s = (now_s // SEARCH_EVERY_S + 1.0) * SEARCH_EVERY_S
                try:
                    run = prepare.within_range(self._model, self._run_so_far.run(), self._gyros)
                    self._search(run, now_s)
                except ImumonError as error:  # a temperature, or what drives the model, is not there so far
                    self._report(f"the model is not searched: {error.seen}")

    def _compare(self, challenger: Challenger, run: Run) -> None:
        ratio, before, after = challenger.compare(run) or (0.0, np.nan, np.nan)
        change = f"{before / DEG_PER_H:.3g} become {after / DEG_PER_H:.3g} °/h"
        if ratio < -DECISIVE:
            self._challenger = None
            self._report(f"the better model is dropped: what came later is less likely with it ({change})")
        elif ratio > DECISIVE:
            self.offered, self._won_on = challenger, run
            self._report(
                f"a better model has won on what came later: {change} (likelihood ratio e^{ratio:.0f}); it is"
                " kept with the session when that ends"
            )

    def _search(self, run: Run, elapsed_s: float) -> None:
        """Search the run so far for what the model lacks, until a better one has won, and report that."""
        if self._challenger and not self.offered:
            self._compare(self._challenger, run)
        if self.offered:
            return
        better_ones = better_models(run, self._model, self._gyros)
        if not better_ones:
            self.state, self._charts = "", []
            return
        worst = max(better_ones, key=lambda better: better.before)
        before, after = worst.before / DEG_PER_H, max(better.after for better in better_ones) / DEG_PER_H
        axes: dict[str, list[str]] = {}
        for better in better_ones:
            axes.setdefault(" or ".join(better.names), []).append(better.channel[-1])
        what = "; ".join(f"{text} on {', '.join(sorted(letters))}" for text, letters in axes.items())
        self.state = f"MODEL CAN BE BETTER: {what}: {before:.3g} become {after:.3g} °/h"
        self._report(
            f"{self.state} (rms of {common_block_s([run]):.0f} s, gain {worst.gain:.0f}):"
            " imumon diagnose --train SESSION --model SESSION --out DIR",
            what,
        )
        challenger, beside = Challenger(self._model, better_ones, elapsed_s), self._challenger
        self._charts = _charts(run, self._model, challenger.model, worst)
        # At twice the age at which it was found, the last model that was found takes a challenger's place: so
        # a session has few challengers, each of which may win by chance once in 3000.
        if self._learn and (not beside or elapsed_s >= 2.0 * beside.since_s):
            self._challenger = challenger

    def evidence(self, session: str, sha256: str) -> TrainedOn:
        """Return what the model that has won states of this session: of the run that proved it."""
        run = replace(self._won_on, origin=Origin(session, 0, sha256))
        return trained_on(prepare.residual_blocks(run, self._model, self._gyros))

    def _report(self, text: str, what: str = "") -> None:
        """Add a text to the log, unless it, or what it is about, is in there already."""
        if (what or text) not in self._reported:
            self._reported.add(what or text)
            self._pending.append(text)

    def lanes(self) -> Mapping[str, LaneState]:
        """Return the lane ``model`` while there is a better one, in the place of what the watch reports."""
        return {"model": LaneState(self.state, Level.WAIT)} if self.state else {}

    def notices(self) -> list[str]:
        """Return, once for each set of effects, what would be better, and what became of it; for the log."""
        texts, self._pending = self._pending, []
        return texts

    def charts(self) -> Sequence[Chart]:
        """Return what the model leaves of the worst axis, with the effect that is missing."""
        return self._charts


def _charts(run: Run, present: BiasModel, better: BiasModel, worst: Better) -> list[Chart]:
    """Return what is left of a channel over time and temperature, and what the better model would take away.

    Block means at rest, °/h, minus their mean, the turn-on bias.  The line is the difference of the models.
    """
    name, axis, what = worst.channel, worst.channel[-1], worst.names[0]
    before, after = (prepare.residual_blocks(run, model, [name]) for model in (present, better))
    both = before.mean[name], before.mean[name] - after.mean[name]
    points, line = ((values - values.mean()) / DEG_PER_H for values in both)
    degc = before.temperature[prepare.temperature_of(name, present, [run])]
    time = "time", before.time_s / 60.0, "time since power-on [min]"
    title = f"Gyro {axis} minus the model, means of {before.block_s:.0f} s, and {what} through it"
    headline = f"{worst.before / DEG_PER_H:.3g} → {worst.after / DEG_PER_H:.3g} °/h"
    notes, charts = (f"{' or '.join(worst.names)}, gain {worst.gain:.0f}",), []
    for key, x, label in (time, ("temperature", degc, "temperature [°C]")):
        dots = Curve(f"left, {axis}", x, points, AXIS_COLORS[axis], points=True, width=4.0)
        effect = Curve(what, x, line, (150, 155, 165))  # reads on both themes, and is no axis' colour
        x_axis, y_axis, over = Axis(label), Axis("bias [°/h]"), f"{title}, over {key}"
        charts += [
            Chart(
                f"model_lacks_over_{key}", "Residual", over, x_axis, y_axis, (dots, effect), headline, notes
            )
        ]
    return charts
