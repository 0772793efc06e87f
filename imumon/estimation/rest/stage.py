"""The rest detector as a stage of the pipeline."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from imumon.blocks import ColumnArray, SampleBlock
from imumon.columns import Column
from imumon.estimation.rest.kernel import detect
from imumon.estimation.rest.parameters import RestParameters
from imumon.estimation.rest.state import new_state

INPUTS = tuple(f"{sensor}_{axis}" for sensor in ("gyro", "accel") for axis in "xyz")
AT_REST = Column("at_rest", "1", "int64", "1 while the unit is at rest, 0 while it moves or nothing is known")


class RestDetector:
    """Finds rest and motion, sample by sample, without knowing the sensors' noise or bias.

    Parameters
    ----------
    parameters : RestParameters
        What a resting unit may do.
    """

    def __init__(self, parameters: RestParameters | None = None) -> None:
        given = parameters or RestParameters()
        self._parameters = np.array(
            [
                given.gyro_g_sensitivity,
                given.doubt_s,
                given.largest_jump,
                *(given.gyro_drift for _ in "xyz"),
                *(given.accel_drift for _ in "xyz"),
            ]
        )
        self._state = new_state()

    @property
    def columns(self) -> Sequence[Column]:
        """The column ``at_rest``."""
        return [AT_REST]

    def process(self, block: SampleBlock) -> Mapping[str, ColumnArray]:
        """Return ``at_rest`` of a block, int64.

        Needs ``device_time_ns`` and ``segment``; takes what there is of gyro_{x,y,z} in rad/s and
        accel_{x,y,z} in m/s².
        """
        n = len(block)
        readings = np.empty((len(INPUTS), n))
        for place, name in enumerate(INPUTS):
            readings[place] = block.columns.get(name, np.nan)
        at_rest = np.zeros(n, np.int64)
        if n:
            time_ns, segment = block["device_time_ns"], block["segment"]
            detect(self._state, self._parameters, time_ns, segment, readings, at_rest)
        return {AT_REST.name: at_rest}

    def notices(self) -> list[str]:
        """Return nothing: there is nothing to declare that the data could contradict."""
        return []
