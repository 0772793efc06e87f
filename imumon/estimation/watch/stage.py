"""The watch over the bias filter as a stage of the pipeline, behind `ZeroVelocity`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from imumon.blocks import NO_INT, ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.columns import Column
from imumon.effects.library import suspected_by
from imumon.estimation.watch.evidence import BLOCK, LEARNING, PATTERNS, Pattern, State, limit, step
from imumon.estimation.watch.parameters import WatchParameters
from imumon.filters.segments import Breaks
from imumon.lane import LaneState, Level

SUSPECT = Column("model_suspect", "1", "int64", "1 once the bias filter is caught at being wrong, else 0")
EXPLAINING_SHARE = 0.7
"""A pattern explains the innovations with at least this share of the strongest evidence.  Assumed."""
DRIVERS = (Pattern.TEMPERATURE, Pattern.RATE, Pattern.TIME)
"""Of a bias; the other patterns are of the innovations themselves."""


class ModelWatch:
    """Detects when the innovations of the bias filter are not what the filter expects.

    They should be white, standard normal, and have nothing to do with temperature, its rate or the time.  A
    suspicion stays until the device restarts: a model that has failed does not get better when the
    temperature comes to rest.  What is tested for, and how often in vain, is in docs/closing-the-loop.md.

    Parameters
    ----------
    modelled : bool
        Whether the filter uses a bias model; it decides what is advised.
    """

    columns: Sequence[Column] = (SUSPECT,)

    def __init__(self, parameters: WatchParameters | None = None, modelled: bool = False) -> None:
        given = parameters or WatchParameters()
        self._alarm_at = limit(given.false_alarm_hours)
        self._modelled = modelled
        self._state = State()
        self._breaks = Breaks()
        self._texts: dict[str, bool] = {}
        """Lines for the log, and whether `notices` has returned them."""

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return ``model_suspect`` of a block, int64.

        Needs ``device_time_ns``, ``segment`` and ``zupt_innovation_{x,y,z}``; takes what there is of
        ``temperature_estimate`` and ``temperature_rate``, of each axis before those of the unit.
        """
        segment, innovations = block["segment"], block.vector("zupt_innovation")
        if innovations is None:
            return {SUSPECT.name: np.zeros(len(block), np.int64)}
        suspect = (segment == self._state.suspect_segment).astype(np.int64)
        slots = np.flatnonzero(np.isfinite(innovations).all(1))
        time_ns, segments = block["device_time_ns"][slots], segment[slots]
        temperature, rate = (_of_axes(block, f"temperature_{name}", slots) for name in ("estimate", "rate"))
        breaks = set(self._breaks.rows(time_ns, segments))
        for k, row in enumerate(slots.tolist()):
            if k in breaks:
                self._state, suspect[row:] = State(), 0
            state = self._state
            if state.slots == 0:
                state.first_ns = int(time_ns[k])
            now_s = 1e-9 * (int(time_ns[k]) - state.first_ns)
            highest = step(state, now_s, innovations[row], temperature[k], rate[k])
            if highest >= self._alarm_at and state.suspect_segment == NO_INT:
                state.suspect_segment = int(segments[k])
                suspect[row:] = segment[row:] == state.suspect_segment
                self._texts.setdefault(interpret(state.peaks, self._modelled)[1], False)
        return {SUSPECT.name: suspect}

    def lanes(self) -> Mapping[str, LaneState]:
        """Return the lane ``model``: MODEL OK, MODEL SUSPECT with the reason, waiting, or no model."""
        if self._state.suspect_segment != NO_INT:
            reason = interpret(self._state.peaks, self._modelled)[0]
            return {"model": LaneState(f"MODEL SUSPECT: {reason}", Level.BAD)}
        if self._state.slots < LEARNING + BLOCK:
            return {"model": LaneState("waiting for rest", Level.WAIT)}
        if not self._modelled:
            return {"model": LaneState("no model; the filter agrees with itself")}
        return {"model": LaneState("MODEL OK", Level.GOOD)}

    def notices(self) -> list[str]:
        """Return, once each, what is suspected and which command tells more; for the log."""
        texts = [text for text, returned in self._texts.items() if not returned]
        self._texts.update(dict.fromkeys(texts, True))
        return texts


def _of_axes(block: SampleBlock, name: str, rows: IntArray) -> FloatArray:
    """Return a column at some rows, of each axis where it has its own, else of the unit, (rows, 3)."""
    nowhere = np.full(len(block), np.nan)
    unit = block.columns.get(name, nowhere)
    of_axes = [block.columns.get(f"{name}_{axis}", nowhere)[rows] for axis in "xyz"]
    return np.column_stack([np.where(np.isfinite(of), of, unit[rows]) for of in of_axes])


def interpret(peaks: FloatArray, modelled: bool) -> tuple[str, str]:
    """Return a short reason and a line for the log, with a bias model in use or not.

    The strongest driver of the bias that explains the innovations is named, before the mere fact that these
    follow each other, and that before their size: an effect does all three.  `peaks` are of `State`, (3, t).
    """
    least = EXPLAINING_SHARE * float(peaks.max())
    strength = {pattern: float(peaks[:, pattern == PATTERNS].max()) for pattern in Pattern}
    explains = [pattern for pattern in Pattern if strength[pattern] >= least]
    drivers = [pattern for pattern in explains if pattern in DRIVERS]
    named = max(drivers, key=strength.__getitem__) if drivers else explains[0]
    does = f"follow {named}" if drivers else str(named)
    highest = peaks[:, named == PATTERNS].max(1)
    axes = ", ".join(axis for axis, peak in zip("xyz", highest, strict=True) if peak >= least)
    start = f"MODEL SUSPECT: on {axes} the innovations of the bias filter {does}"
    return f"innovations {does}", f"{start}; {_advice(named, modelled)}"


def _advice(named: Pattern, modelled: bool) -> str:
    """Return what may be the cause, and which command tests it."""
    if named is Pattern.VARIANCE:
        return "the noise declared is too small, or something shakes the unit: imumon allan SESSION"
    if not modelled and named in (Pattern.TEMPERATURE, Pattern.RATE):
        return "there is no model of the bias: imumon calibrate SESSION --out MODEL.yaml"
    lacks = "the model lacks" if modelled else "there may be"
    # A session that ran with a model has it.
    diagnose = f"imumon diagnose --train SESSION{' --model SESSION' * modelled} --out DIR"
    return f"{lacks} an effect such as {', '.join(suspected_by(named))}: {diagnose}"
