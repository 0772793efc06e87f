"""What the filters of one axis have in common: samples in, a series out, call after call."""

from __future__ import annotations

from abc import ABC, abstractmethod
from typing import Generic, TypeVar

import numpy as np

from imumon.blocks import BoolArray, FloatArray

Series = TypeVar("Series")


class ScalarFilter(ABC, Generic[Series]):
    """A filter of one axis; what it carries on is changed by each call."""

    def process(
        self, reading: FloatArray, measured: BoolArray | None = None, steps: FloatArray | None = None
    ) -> Series:
        """Return what the filter says at samples that follow those of the last call.

        Parameters
        ----------
        reading : array, (n,)
            Data; predicted only where it is NaN or not `measured`.
        measured : array of bool, (n,), optional
            Whether the sample may be learnt from: the unit is at rest.  Default always.
        steps : array, (n,), optional
            Time since the last sample in sampling intervals.  Default 1.
        """
        use = np.isfinite(reading) if measured is None else measured & np.isfinite(reading)
        return self._filter(reading, use, np.ones(len(reading)) if steps is None else steps)

    @abstractmethod
    def _filter(self, reading: FloatArray, use: BoolArray, steps: FloatArray) -> Series:
        """Filter samples, of which some are of use."""
