"""What a curve is fitted to."""

from dataclasses import dataclass, fields, replace
from typing import Self

import numpy as np

from imumon.blocks import BoolArray, FloatArray, IntArray


@dataclass(frozen=True, eq=False)
class Points:
    """Means of one channel at rest, each over a stretch of nearly constant temperature."""

    temperature: FloatArray  # °C, (n,)
    value: FloatArray  # mean of the channel, rad/s or m/s², (n,)
    weight: FloatArray  # inverse variance of the mean, in any unit, (n,)
    level: IntArray  # level of temperature that the mean belongs to, counted upwards, (n,): left out together

    def __len__(self) -> int:
        return len(self.temperature)

    def only(self, chosen: BoolArray) -> Self:
        """Return the means that are chosen."""
        return replace(self, **{field.name: getattr(self, field.name)[chosen] for field in fields(self)})

    def merged(self, width: float) -> "Points":
        """Return weighted means of those of the same level that are in the same `width` of °C.

        To a curve that is smooth over `width` they are worth the same, and there are fewer of them.
        """
        bin_of = np.floor((self.temperature - self.temperature.min()) / width).astype(np.int64)
        keys, which = np.unique(np.column_stack([self.level, bin_of]), axis=0, return_inverse=True)
        weight = np.bincount(which, self.weight).astype(np.float64)
        temperature = np.bincount(which, self.weight * self.temperature) / weight
        value = np.bincount(which, self.weight * self.value) / weight
        return Points(temperature, value, weight, keys[:, 0])


def folds(level: IntArray, most: int) -> list[BoolArray]:
    """Return which means to leave out at a time, (n,) of bool each: whole levels, no neighbours, no edges.

    The lowest and the highest level stay in: without them the curve would have to extrapolate, which it does
    not do in use.  With fewer than three levels there is nothing to leave out.
    """
    inner = np.unique(level)[1:-1]
    return [np.isin(level, inner[start::most]) for start in range(min(most, len(inner)))]
