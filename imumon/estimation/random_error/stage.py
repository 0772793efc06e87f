"""Random error of gyros as a stage of the pipeline: one estimator per axis.

The zero of the estimate is a rate of nought: it is what the gyro reads at rest, less the thermal bias of a
model where there is one.  So it holds the turn-on bias, the drift since, and the earth's rate along the axis
(15 °/h at most).  A difference of two of its values is drift alone.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import numpy as np
import numpy.typing as npt

from imumon.blocks import NO_INT, ColumnArray, FloatArray, IntArray, SampleBlock
from imumon.columns import Column
from imumon.estimation.random_error.drift import DriftFilter
from imumon.estimation.random_error.parameters import Channel, RandomErrorParameters
from imumon.estimation.random_error.slots import SlotGatherer, Slots, spread
from imumon.models.model import BiasModel
from imumon.models.predictor import BiasPredictor

AXES = "xyz"
UNMODELLED_DEGC = 1.0
"""More than this without a bias model is said."""
PATIENCE_NS = 10_000_000_000
"""So long a column that is needed may fail to come before that is said."""

Series = dict[str, FloatArray]


class RandomError:
    """Drift of each gyro axis at rest, held in motion, with its standard deviation.

    Parameters
    ----------
    parameters : RandomErrorParameters
        One set for all axes.
    model : BiasModel, optional
        Its bias is taken off before; axes that it lacks keep theirs.
    """

    def __init__(
        self, parameters: RandomErrorParameters | None = None, model: BiasModel | None = None
    ) -> None:
        self._parameters = parameters or RandomErrorParameters()
        self._axes = {axis: _Axis(_channel(axis), self._parameters) for axis in AXES}
        names = [_channel(axis) for axis in AXES if model is not None and _channel(axis) in model.channels]
        self._modelled = names
        self._predictor = BiasPredictor(model, names) if model is not None and names else None
        self._waited_ns = 0
        self._last: tuple[int, int] | None = None
        self._seen = {"rest": False, "temperature": False}
        self._temperatures = np.array([np.inf, -np.inf])
        self._said: set[str] = set()
        self._columns = self._described()
        self._order = [column.name for column in self._columns]

    @property
    def columns(self) -> Sequence[Column]:
        """The columns that `process` adds."""
        return self._columns

    def _described(self) -> list[Column]:
        return [
            *(
                Column(f"gyro_random_error_{a}", "rad/s", description=f"what gyro {a} reads at rest")
                for a in AXES
            ),
            *(
                Column(f"gyro_random_error_sd_{a}", "rad/s", description="its standard deviation")
                for a in AXES
            ),
        ]

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return the new columns of a block; NaN where there is no estimate.

        Needs ``device_time_ns`` and ``segment``; uses ``gyro_x`` and so on, ``at_rest``, and the
        temperatures of the model.  Rows before the first usable one do not matter.
        """
        times = block["device_time_ns"]
        if len(times):
            self._waited_ns += max(int(times[-1] - times[0]), 0)
        broken = self._breaks(times, block["segment"])
        rest = self._rest(block)
        bias = self._bias(block)
        found: dict[str, ColumnArray] = {}
        for axis, one in self._axes.items():
            name = _channel(axis)
            reading = np.array(block[name], np.float64) if name in block else np.full(len(block), np.nan)
            if name in bias:
                reading -= bias[name]
            result = one.process(times, block["segment"], broken, reading, rest)
            for column, values in result.items():
                found[f"{column}_{axis}"] = values
        return {name: found[name] for name in self._order}

    def _breaks(self, time_ns: IntArray, segment: IntArray) -> IntArray:
        """Return the rows at which a segment begins or time runs back; what was shown is void from there."""
        if not len(time_ns):
            return np.empty(0, np.int64)
        last = (int(segment[0]), int(time_ns[0])) if self._last is None else self._last
        at_once = segment[0] != last[0] or time_ns[0] < last[1]
        self._last = int(segment[-1]), int(time_ns[-1])
        later = 1 + np.flatnonzero((segment[1:] != segment[:-1]) | (time_ns[1:] < time_ns[:-1]))
        return np.concatenate([np.zeros(int(at_once), np.int64), later])

    def _rest(self, block: SampleBlock) -> npt.NDArray[np.bool_]:
        if "at_rest" in block:
            self._seen["rest"] = True
            known = block["at_rest"]
            return np.asarray((known != 0) & (known != NO_INT))
        return np.full(len(block), self._parameters.assume_rest)

    def _bias(self, block: SampleBlock) -> dict[str, FloatArray]:
        """Return the thermal bias of the axes that have a model; NaN before the first temperature."""
        temperatures = block.temperature
        if temperatures is not None and np.isfinite(temperatures).any():
            self._temperatures[0] = min(self._temperatures[0], np.nanmin(temperatures))
            self._temperatures[1] = max(self._temperatures[1], np.nanmax(temperatures))
        if self._predictor is None:
            return {}
        columns = self._predictor.temperature_columns
        temperature = np.full((len(block), len(columns)), np.nan)
        for j, name in enumerate(columns):
            if name in block:
                temperature[:, j] = block[name]
        self._seen["temperature"] |= bool(np.isfinite(temperature).any())
        predicted = self._predictor.process(block["device_time_ns"], block["segment"], temperature).bias
        return {name: predicted[:, j] for j, name in enumerate(self._modelled)}

    def notices(self) -> list[str]:
        """Return, once each, why there is no estimate, and what jumped."""
        found = {}
        waited = self._waited_ns > PATIENCE_NS
        if waited and not self._seen["rest"] and not self._parameters.assume_rest:
            found["rest"] = (
                "random error: nothing says when the unit is at rest (no column at_rest): no estimate"
            )
        if waited and self._predictor is not None and not self._seen["temperature"]:
            wanted = ", ".join(sorted(set(self._predictor.temperature_columns)))
            found["temperature"] = (
                f"random error: the bias model needs {wanted}, which has not come: no estimate"
            )
        change = self._temperatures[1] - self._temperatures[0]
        if change > UNMODELLED_DEGC and len(self._modelled) < len(AXES):
            found["thermal"] = (
                f"random error: the temperature has changed by more than {UNMODELLED_DEGC:g} °C and there is "
                "no bias model of every gyro: what drift that makes is in the estimate, and the sigma does "
                "not know of it"
            )
        for axis, one in self._axes.items():
            found |= {
                f"{axis} {key}": f"random error of gyro {axis}: {text}" for key, text in one.remarks().items()
            }
        new = [text for key, text in found.items() if key not in self._said]
        self._said |= found.keys()
        return new


def _channel(axis: str) -> Channel:
    return _CHANNELS[axis]


_CHANNELS: dict[str, Channel] = {"x": "gyro_x", "y": "gyro_y", "z": "gyro_z"}


class _Axis:
    """All filters of one axis."""

    def __init__(self, channel: Channel, parameters: RandomErrorParameters) -> None:
        self._gatherer = SlotGatherer()
        self._drift = DriftFilter(parameters.noise.get(channel))
        self._last = dict.fromkeys(("estimate", "sd"), math.nan)

    def process(
        self,
        time_ns: IntArray,
        segment: IntArray,
        broken: IntArray,
        reading: FloatArray,
        rest: npt.NDArray[np.bool_],
    ) -> Series:
        """Return the columns of this axis by name without the axis."""
        slots = self._gatherer.process(time_ns, segment, reading, rest)
        drift = self._drift.process(slots)
        n = len(reading)
        estimate = self._spread("estimate", slots, drift.estimate, broken, n)
        sd = self._spread("sd", slots, drift.sd, broken, n)
        return {"gyro_random_error": estimate, "gyro_random_error_sd": sd}

    def _spread(self, name: str, slots: Slots, values: FloatArray, broken: IntArray, n: int) -> FloatArray:
        """Return what is shown at each row: the last slot's value, and none from a break to the next slot."""
        out = np.empty(n)
        self._last[name] = spread(self._last[name], slots.row, values, broken, out)
        return out

    def remarks(self) -> dict[str, str]:
        """Return what the user should know, by a key each."""
        found = {}
        if self._drift.restarts:
            found["jump"] = "a level that jumped and stayed for a minute was taken for the new one"
        factor = self._drift.contradiction
        if factor is not None:
            found["noise"] = f"the given noise contradicts the data, which vary {factor:.2g} times as much"
        return found
