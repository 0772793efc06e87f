"""The diagnosis of the session that is running, as a stage behind the bias filter."""

from __future__ import annotations

from collections.abc import Callable, Collection, Mapping, Sequence
from itertools import pairwise

import numpy as np

from imumon.blocks import ColumnArray, SampleBlock
from imumon.charts import BLUE, RED, Axis, Chart, Curve
from imumon.columns import Column
from imumon.diagnosis.aged import AgedRun
from imumon.diagnosis.blocks import BLOCK_S, common_block_s
from imumon.diagnosis.glance import Better, better_models, known_to
from imumon.diagnosis.runs import DRIVERS, LONGEST_GAP_S, SECOND_NS, Run, further_columns
from imumon.diagnosis.selection import MOST_NAMES
from imumon.diagnosis.shadow import MARGIN, Shadow
from imumon.diagnosis.through import RESIDUAL, effect_charts
from imumon.geodesy import DEG_PER_H
from imumon.models.model import BiasModel, TrainedOn
from imumon.models.predictor import BiasPredictor
from imumon.recordings.reduced import ACCEL, GYRO, TEMPERATURES, KeptSlots, gatherer_of, kept_slots

LANE = "model"
FIRST_LOOK_S, LOOK_S = 1200.0, 600.0
"""The first look has forty means of 30 s, the least that a diagnosis needs; the next ones come at even
distances, so that nothing goes unseen for longer, and cost less than a thousandth of a core."""
JUDGED_S = 300.0
"""How often a shadow is judged: ten means of 30 s."""
HAD = 2.0
"""A shadow has as much time to win as it was found in; then what was found last takes its place."""
HELD_NS = 10 * SECOND_NS
"""Samples wait so long until they are reduced to seconds: short blocks then cost no more than long ones."""
DIAGNOSE = "imumon diagnose --train SESSION --model SESSION --out DIR"


class LiveDiagnosis:
    """Says when a better model than the present one exists: MODEL CAN BE BETTER, with effect, gain and error.

    A run from power-on is looked at after 20 min, and every 10 min from then on.

    Parameters
    ----------
    model : BiasModel
        The present one; the gyros that it has are watched.
    learn : bool
        Whether a better model is then run beside it, and offered after it has won on what came later.
    made : callable
        Tells which columns other stages make: they drive nothing.
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
        self._said: set[str] = set()
        self._last_ns = 0
        self.offered: Shadow | None = None
        """The better model that has won, to be kept when the session ends."""
        self._begin()

    def _begin(self) -> None:
        """Begin with a run from power-on; a shadow that has not won yet is of another."""
        self._aged = AgedRun(self._names)
        self._next_look_s, self._next_judged_s = FIRST_LOOK_S, 0.0
        self._shadow: Shadow | None = None
        self._lacking: list[Chart] = []
        self.state = ""

    @property
    def columns(self) -> Sequence[Column]:
        """None: what it finds is said."""
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
        """Take seconds of one run, and stop wherever it is time to look or to judge."""
        while len(part):
            elapsed = self._aged.elapsed_s(part)
            due = min(self._next_look_s, self._next_judged_s if self._shadow is not None else np.inf)
            count = min(int(np.searchsorted(elapsed, due)) + 1, len(part))
            self._aged.take(part[:count])
            now_s, part = float(elapsed[count - 1]), part[count:]
            if self._shadow is not None and now_s >= self._next_judged_s:
                self._judge(self._shadow, now_s)
            if now_s >= self._next_look_s:
                self._look(now_s)

    def _look(self, elapsed_s: float) -> None:
        self._next_look_s = (elapsed_s // LOOK_S + 1.0) * LOOK_S
        if self.offered is not None:
            return
        if not self._aged.has_any({*self._temperatures, *TEMPERATURES}):
            wanted = " or ".join(self._temperatures)
            self._say(f"what the model lacks is not told: the device has not sent any {wanted} so far")
            return
        run = self._run()
        found = better_models(run, self._model, self._gyros)
        if not found:
            self.state, self._lacking = "", []
            return
        best = max(found, key=lambda one: one.gain)
        before, after = (max(getattr(one, key) for one in found) / DEG_PER_H for key in ("before", "after"))
        what = "; ".join(_said(found))
        self.state = f"MODEL CAN BE BETTER: {what}: {before:.3g} become {after:.3g} °/h"
        length = common_block_s([run])
        self._say(f"{self.state} (rms of {length:.0f} s, gain {best.gain:.0f}): {DIAGNOSE}", what)
        shadow = Shadow(self._model, found, elapsed_s)
        self._lacking = effect_charts(run, self._model, shadow.model, best)
        if self._learn and (self._shadow is None or elapsed_s >= HAD * self._shadow.since_s):
            self._shadow, self._next_judged_s = shadow, elapsed_s + JUDGED_S

    def _judge(self, shadow: Shadow, elapsed_s: float) -> None:
        self._next_judged_s = elapsed_s + JUDGED_S
        score = shadow.judge(self._run())
        if score is None:
            return
        before, after = (value / DEG_PER_H for value in score.rms)
        if score.lost:
            self._shadow, self.state = None, ""
            self._say(f"the better model did worse on what came later: {before:.3g} became {after:.3g} °/h")
        elif score.won and self.offered is None:
            self.offered = shadow
            self._say(
                f"a better model has won on what came later: {before:.3g} become {after:.3g} °/h"
                f" (likelihood ratio e^{score.ratio:.0f}); it is kept with the session when that ends"
            )

    def _run(self) -> Run:
        """Return the run so far, at rest only where the present model knows the temperature."""
        return known_to(self._model, self._aged.run(), self._gyros)

    def evidence(self, session: str, sha256: str) -> TrainedOn:
        """Return what a learned model says of this session."""
        run = self._run()
        at_rest = run.at_rest
        known = [run.mean[name] for name in self._temperatures if name in run.mean]
        temperature = np.concatenate([values[at_rest & np.isfinite(values)] for values in known])
        gyro = self._gyros[0]
        rest_s = float(run.count[gyro][at_rest].sum()) / run.samples_per_slot(gyro) * run.slot_s
        return TrainedOn(
            session=session,
            sha256=sha256,
            rest_s=rest_s,
            blocks=int(rest_s // BLOCK_S),
            temperature_range_degc=[float(temperature.min()), float(temperature.max())],
        )

    def _say(self, text: str, what: str = "") -> None:
        """Say a text for the log, unless it, or what it is about, has been said."""
        if (what or text) not in self._said:
            self._said.add(what or text)
            self._pending.append(text)

    def lanes(self) -> Mapping[str, str]:
        """Return the lane ``model`` while there is a better one, in the place of what the watch says."""
        return {LANE: self.state} if self.state else {}

    def notices(self) -> list[str]:
        """Return, once for each set of effects, what would be better, and what became of it; for the log."""
        texts, self._pending = self._pending, []
        return texts

    def charts(self) -> Sequence[Chart]:
        """Return what the model lacks, and the errors of both models while a better one runs beside."""
        shadow = self.offered or self._shadow
        if shadow is None or shadow.score is None:
            return self._lacking
        score = shadow.score
        minutes = score.time_s / 60.0
        curves = (
            Curve("present model", minutes, score.present / DEG_PER_H, RED),
            Curve("better model", minutes, score.shadow / DEG_PER_H, BLUE),
        )
        before, after = (value / DEG_PER_H for value in score.rms)
        verdict = "it wins beyond" if self.offered is None else "it has won, beyond"
        return [
            *self._lacking,
            Chart(
                "model_better",
                RESIDUAL,
                f"Error of means of {score.block_s:.0f} s, present and better model",
                Axis("time since power-on [min]"),
                Axis("[°/h]"),
                curves,
                headline=f"{before:.3g} → {after:.3g} °/h since it was found",
                notes=(f"likelihood ratio e^{score.ratio:.1f}; {verdict} e^{MARGIN:.0f}",),
            ),
        ]


def _said(found: Sequence[Better]) -> list[str]:
    """Return which effects may be missing on which axes: up to three, or that it is not told yet."""
    axes: dict[str, list[str]] = {}
    for one in sorted(found, key=lambda one: -one.gain):
        more = len(one.names) - MOST_NAMES
        text = " or ".join(one.names[:MOST_NAMES]) + (f" or {more} others, not told yet," if more > 0 else "")
        axes.setdefault(text, []).append(one.channel[-1])
    return [f"{text} on {', '.join(sorted(letters))}" for text, letters in axes.items()]
