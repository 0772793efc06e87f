"""Slow readings of a side stream, held in the rows of the main one: a thermometer with a time of its own."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from imumon.blocks import FloatArray, IntArray, SampleBlock
from imumon.columns import TEMPERATURES
from imumon.protocols.epochs import Epochs


class HeldReadings:
    """Adds to main rows the latest reading of the side streams, whatever the division into blocks.

    The estimators of the inertial sensors need temperatures in every row, however seldom they come.

    A reading holds from the first main row that was begun after it was complete; a row's own counts first.
    """

    def __init__(self) -> None:
        self._latest: dict[str, float] = {}
        self._rows = 0

    @property
    def names(self) -> frozenset[str]:
        """The columns that are held so far."""
        return frozenset(self._latest)

    def process(self, main: SampleBlock, side: Mapping[str, Epochs]) -> SampleBlock:
        """Return main rows with the columns of `TEMPERATURES` that only side streams have."""
        first = self._rows
        self._rows += len(main)
        for name in TEMPERATURES:
            having = [epochs for epochs in side.values() if name in epochs.block]
            if having or name in self._latest:
                values = np.concatenate([np.zeros(0), *(epochs.block[name] for epochs in having)])
                at = np.concatenate([np.zeros(0, np.int64), *(epochs.until - first for epochs in having)])
                main = self._with(main, name, values, at)
        return main

    def _with(self, main: SampleBlock, name: str, values: FloatArray, at: IntArray) -> SampleBlock:
        """Return the rows with these readings held from row `at` of the block on, where there is none."""
        there = np.isfinite(values)
        values, at = values[there], at[there]
        order = np.argsort(at, kind="stable")
        known = np.concatenate([[self._latest.get(name, np.nan)], values[order]])
        held = known[np.searchsorted(at[order], np.arange(len(main)), side="right")]
        self._latest[name] = float(known[-1])
        if name in main:
            held = np.where(np.isnan(main[name]), held, main[name])
        return main.with_columns({name: held})
