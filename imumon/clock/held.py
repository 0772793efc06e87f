"""Slow readings of a side stream, held in the rows of the main one: a thermometer with a time of its own."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from imumon.blocks import FloatArray, IntArray, SampleBlock
from imumon.protocols.epochs import Epochs

HELD = ("temperature", "temperature_x", "temperature_y", "temperature_z")
"""What the estimators of the inertial sensors need in every row, however seldom it comes."""


class HeldReadings:
    """Adds to main rows the latest reading of a side stream, whatever the division into blocks.

    A reading holds from the first main row that was begun after it was complete.
    """

    def __init__(self) -> None:
        self._latest: dict[str, float] = {}
        self._rows = 0

    @property
    def names(self) -> frozenset[str]:
        """The columns that are held so far."""
        return frozenset(self._latest)

    def process(self, main: SampleBlock, side: Mapping[str, Epochs]) -> SampleBlock:
        """Return main rows with the columns of `HELD` that only side streams have."""
        first, n = self._rows, len(main)
        self._rows += n
        for epochs in side.values():
            for name in HELD:
                if name in epochs.block and (name not in main or name in self._latest):
                    main = self._with(main, name, epochs.block[name], epochs.until - first)
        for name in self._latest.keys() - main.columns.keys():
            main = main.with_columns({name: np.full(n, self._latest[name])})
        return main

    def _with(self, main: SampleBlock, name: str, values: FloatArray, at: IntArray) -> SampleBlock:
        """Return the rows with these readings held from row `at` of the block on."""
        there = np.isfinite(values)
        known = np.concatenate([[self._latest.get(name, np.nan)], values[there]])
        which = np.searchsorted(at[there], np.arange(len(main)), side="right")
        self._latest[name] = float(known[-1])
        return main.with_columns({name: known[which]})
