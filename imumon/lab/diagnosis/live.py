"""The diagnosis of the session that is running, as a stage behind the bias filter."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from itertools import pairwise

import numpy as np

from imumon.blocks import ColumnArray, FloatArray, SampleBlock
from imumon.charts import AXIS_COLORS, Axis, Chart, Curve
from imumon.columns import Column
from imumon.effects.vibration import SECOND_NS
from imumon.errors import ImumonError
from imumon.geodesy import DEG_PER_H
from imumon.lab.diagnosis.better import Better, Challenger, better_models
from imumon.lab.diagnosis.blocks import common_block_s, make_blocks
from imumon.lab.diagnosis.choice import PROVEN
from imumon.lab.diagnosis.extended import trained_on
from imumon.lab.diagnosis.known import residual, temperature_of, within_range
from imumon.lab.diagnosis.runs import (
    DRIVERS,
    LONGEST_GAP_S,
    Origin,
    Run,
    add_vibration,
    further_columns,
)
from imumon.lane import LaneState, Level
from imumon.models.model import BiasModel, TrainedOn
from imumon.models.predictor import BiasPredictor
from imumon.recordings.reduced import ACCEL, GYRO, KeptSlots, gatherer_of, kept_slots

LANE, RESIDUAL = "model", "Residual"
FIRST_SEARCH_S, SEARCH_EVERY_S = 1200.0, 600.0
"""The first search has forty means of 30 s, the least that a diagnosis needs; the next ones follow at even
distances, so that nothing stays unnoticed for longer."""
REPLACED_AFTER = 2.0
"""Times the age at which a challenger was found: by then the last model that was found takes its place."""
HELD_NS = 10 * SECOND_NS
"""Samples wait so long until they are reduced to seconds: short blocks then cost no more than long ones."""
MOST_SLOTS = 7200
"""Of a run in memory: two hours of seconds; a column takes 32 bytes of each."""
INK = (150, 155, 165)
"""Colour of the effect in a chart: it reads on both themes, and is no axis' colour."""


class LiveDiagnosis:
    """Reports when a better model than the present one exists: MODEL CAN BE BETTER, with effect and error.

    The gyros of the present model are searched 20 min after power-on, and every 10 min from then on.  With
    `learn` a better model then runs beside it, and is offered after it has won on what came later.  `made`
    returns the columns that other stages make: they drive nothing.
    """

    def __init__(
        self, model: BiasModel, learn: bool = False, made: Callable[[], Collection[str]] = tuple
    ) -> None:
        self._model, self._learn, self._made = model, learn, made
        self._gyros = [name for name in GYRO if name in model.channels]
        wanted = BiasPredictor(model, self._gyros)
        self._needed = wanted.drivers
        self._temperatures = [name.replace("_estimate", "") for name in wanted.temperature_columns]
        self._temperatures = list(dict.fromkeys([*self._temperatures, "temperature"]))
        self._names: list[str] = []
        self._gatherer = gatherer_of(self._names, 1.0)
        self._waiting: list[SampleBlock] = []
        self._pending: list[str] = []
        self._reported: set[str] = set()
        self._last_ns = 0
        self.offered: Challenger | None = None
        """The better model that has won, to be kept when the session ends."""
        self._begin()

    def _begin(self) -> None:
        """Begin with a run from power-on; a challenger that has not won yet is of another."""
        self._run_so_far = BoundedRun(self._names)
        self._next_search_s = FIRST_SEARCH_S
        self._challenger: Challenger | None = None
        self._lacking: list[Chart] = []
        self.state = ""

    @property
    def columns(self) -> Sequence[Column]:
        """None: what it finds is reported."""
        return []

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Take samples; needs ``device_time_ns``, ``segment``, gyros and temperature, takes ``at_rest``."""
        if len(block) and all(name in block for name in self._gyros):
            self._waiting.append(block)
            since = int(self._waiting[0]["device_time_ns"][0])
            if not 0 <= int(block["device_time_ns"][-1]) - since < HELD_NS:
                self._reduce()
        return {}

    def _reduce(self) -> None:
        if not self._names:
            known = [name for name in (*ACCEL, *DRIVERS) if any(name in block for block in self._waiting)]
            made = self._made()
            more = [name for block in self._waiting for name in further_columns(block, made)]
            self._names = [*dict.fromkeys([*self._gyros, *self._temperatures, *self._needed, *known, *more])]
            self._gatherer = gatherer_of(self._names, 1.0)
            self._begin()
        for block in self._waiting:
            for slots in kept_slots(self._gatherer, block, self._names):
                self._take(slots)
        self._waiting = []

    def _take(self, slots: KeptSlots) -> None:
        """Take the seconds that have ended; a new segment is a new run, and what comes after a long gap."""
        if not len(slots):
            return
        gap_ns = np.diff(slots.start_ns, prepend=self._last_ns)
        self._last_ns = int(slots.end_ns[-1])
        begins = slots.begins | (gap_ns > LONGEST_GAP_S * SECOND_NS)
        for start, stop in pairwise([0, *np.flatnonzero(begins).tolist(), len(slots)]):
            if stop > start:
                if begins[start]:
                    self._begin()
                self._follow(slots[start:stop])

    def _follow(self, part: KeptSlots) -> None:
        """Take seconds of one run, and stop wherever a search is due."""
        while len(part):
            elapsed = self._run_so_far.elapsed_s(part)
            count = min(int(np.searchsorted(elapsed, self._next_search_s)) + 1, len(part))
            self._run_so_far.take(part[:count])
            now_s, part = float(elapsed[count - 1]), part[count:]
            if now_s >= self._next_search_s:
                self._next_search_s = (now_s // SEARCH_EVERY_S + 1.0) * SEARCH_EVERY_S
                self._compare()
                self._search(now_s)

    def _compare(self) -> None:
        """Compare the model that runs beside the present one with it, on what came since it was found."""
        found = None if self._challenger is None or self.offered else self._challenger.compare(self._run())
        if found is None:
            return
        change = f"{found.before / DEG_PER_H:.3g} become {found.after / DEG_PER_H:.3g} °/h"
        if found.ratio < -PROVEN:
            self._challenger = None
            self._report(f"the better model is dropped: what came later is less likely with it ({change})")
        elif found.ratio > PROVEN:
            self.offered = self._challenger
            self._report(
                f"a better model has won on what came later: {change} (likelihood ratio e^{found.ratio:.0f});"
                " it is kept with the session when that ends"
            )

    def _search(self, elapsed_s: float) -> None:
        """Search the run so far for what the model lacks, and report that."""
        if self.offered is not None:
            return
        try:
            run = self._run()
        except ImumonError as error:  # the device has not sent a temperature so far
            self._report(f"the model is not searched: {error.seen}")
            return
        found = better_models(run, self._model, self._gyros)
        if not found:
            self.state, self._lacking = "", []
            return
        best = max(found, key=lambda one: one.gain)
        before, after = (max(getattr(one, key) for one in found) / DEG_PER_H for key in ("before", "after"))
        what = "; ".join(_effects_by_axes(found))
        self.state = f"MODEL CAN BE BETTER: {what}: {before:.3g} become {after:.3g} °/h"
        length = common_block_s([run])
        self._report(
            f"{self.state} (rms of {length:.0f} s, gain {best.gain:.0f}):"
            " imumon diagnose --train SESSION --model SESSION --out DIR",
            what,
        )
        challenger = Challenger(self._model, found, elapsed_s)
        self._lacking = _charts(run, self._model, challenger.model, best)
        if self._learn and (
            self._challenger is None or elapsed_s >= REPLACED_AFTER * self._challenger.since_s
        ):
            self._challenger = challenger

    def _run(self) -> Run:
        """Return the run so far, at rest only where the present model knows the temperature."""
        return within_range(self._model, self._run_so_far.run(), self._gyros)

    def evidence(self, session: str, sha256: str) -> TrainedOn:
        """Return what a learned model states of this session."""
        run = replace(self._run(), origin=Origin(session, 0, sha256))
        return trained_on(make_blocks(run, self._gyros, self._temperatures))

    def _report(self, text: str, what: str = "") -> None:
        """Add a text to the log, unless it, or what it is about, is in there already."""
        if (what or text) not in self._reported:
            self._reported.add(what or text)
            self._pending.append(text)

    def lanes(self) -> Mapping[str, LaneState]:
        """Return the lane ``model`` while there is a better one, in the place of what the watch reports."""
        return {LANE: LaneState(self.state, Level.WAIT)} if self.state else {}

    def notices(self) -> list[str]:
        """Return, once for each set of effects, what would be better, and what became of it; for the log."""
        texts, self._pending = self._pending, []
        return texts

    def charts(self) -> Sequence[Chart]:
        """Return what the model leaves of the worst axis, with the effect that is missing."""
        return self._lacking


def _effects_by_axes(found: Sequence[Better]) -> list[str]:
    """Return which effects may be missing on which axes."""
    axes: dict[str, list[str]] = {}
    for one in sorted(found, key=lambda one: -one.gain):
        axes.setdefault(" or ".join(one.names), []).append(one.channel[-1])
    return [f"{text} on {', '.join(sorted(letters))}" for text, letters in axes.items()]


def _charts(run: Run, present: BiasModel, better: BiasModel, one: Better) -> list[Chart]:
    """Return what is left of a channel over time and temperature, and what the better model would take away.

    Block means at rest, °/h, less their mean, which is the turn-on bias.  The line through them is the
    difference of the two models.
    """
    name = one.channel
    left, after = (residual(run, model, [name]) for model in (present, better))
    both = left.mean[name], left.mean[name] - after.mean[name]
    points, line = ((part - part.mean()) / DEG_PER_H for part in both)
    axis, what = name[-1], one.names[0]
    over = {
        "time": (left.time_s / 60.0, "time since power-on [min]"),
        "temperature": (left.temperature[temperature_of(name, present, [run])], "temperature [°C]"),
    }
    return [
        Chart(
            f"model_lacks_over_{key}",
            RESIDUAL,
            f"Gyro {axis} less the model, means of {left.block_s:.0f} s, and {what} through it",
            Axis(label),
            Axis("[°/h]"),
            (
                Curve(f"left, {axis}", x, points, AXIS_COLORS[axis], points=True, width=4.0),
                Curve(what, x, line, INK),
            ),
            headline=f"{one.before / DEG_PER_H:.3g} → {one.after / DEG_PER_H:.3g} °/h",
            notes=(f"{' or '.join(one.names)}, gain {one.gain:.0f}",),
        )
        for key, (x, label) in over.items()
    ]


class BoundedRun:
    """Sums over slots of 1, 2, 4, ... s: where they would be too many, neighbours are added in pairs.

    Gyros count at rest only, so that the rest of a slot counts in which the unit moved for a while.
    """

    def __init__(self, names: Sequence[str]) -> None:
        self._names = list(names)
        self._gyros = [at for at, name in enumerate(names) if name in GYRO]
        self._sums = np.zeros((MOST_SLOTS, 4, len(names)))
        """Samples, their sum, squares about the means of seconds, and degrees of freedom of these."""
        self._width, self._last, self._begun_ns = 1, -1, 0

    def elapsed_s(self, part: KeptSlots) -> FloatArray:
        """Return the time from the first sample to the end of each second, (n,)."""
        begun_ns = self._begun_ns if self._last >= 0 else int(part.start_ns[0])
        return np.asarray((part.end_ns - begun_ns) / SECOND_NS)

    def take(self, part: KeptSlots) -> None:
        """Add seconds; the last column of the part is the share at rest, which is not one of the run's."""
        if self._last < 0:
            self._begun_ns = int(part.start_ns[0])
        second = (part.start_ns - self._begun_ns) // SECOND_NS
        self._last = int(second[-1])
        while self._last // self._width >= MOST_SLOTS:
            half = MOST_SLOTS // 2
            self._sums[:half] = self._sums[::2] + self._sums[1::2]
            self._sums[half:] = 0.0
            self._width *= 2
        count = part.count[:, :-1].astype(np.float64)
        count[:, self._gyros] *= (part.mean[:, -1] == 1.0)[:, np.newaxis]
        mean, variance = (np.where(count > 0, part_of[:, :-1], 0.0) for part_of in (part.mean, part.variance))
        more = np.stack([count, mean * count, variance * count, np.maximum(count - 1.0, 0.0)], axis=1)
        np.add.at(self._sums, second // self._width, more)

    def run(self) -> Run:
        """Return the run so far, in slots that have ended; at rest where a gyro was."""
        n = max(1, (self._last + 1) // self._width)
        count, total, scatter, free = self._sums[:n].swapaxes(0, 1)
        there = [at for at in range(len(self._names)) if at in self._gyros or count[:, at].any()]

        def ratio(sums: FloatArray, by: FloatArray) -> dict[str, FloatArray]:
            values = np.where(by > 0, sums / np.maximum(by, 1.0), np.nan)
            return {self._names[at]: values[:, at] for at in there}

        mean, variance = ratio(total, count), ratio(scatter, free)
        add_vibration(mean, variance)
        if self._width > 1:
            # The scatter of samples within seconds does not show that of means of many seconds.
            variance = {name: np.full(n, np.nan) for name in variance}
        return Run(
            name="this session",
            time_s=np.asarray((np.arange(n) + 0.5) * self._width),
            count={self._names[at]: count[:, at].copy() for at in there},
            mean=mean,
            variance=variance,
            rest=np.asarray((count[:, self._gyros] > 0).all(axis=1), np.float64),
            slot_s=float(self._width),
        )
