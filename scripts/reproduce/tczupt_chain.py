"""The paper's chain, whole: soak, network, rate of temperature, and with them ZUPT and TCZUPT on the ramp.

Nothing of the truth is used: the log of the chamber says what has settled, the networks are trained on means
of the soak, and temperature and rate are those of the thermometer of the ramp.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from study import rms
from tczupt_records import DPH, Calibration, Filter, curves, slopes
from thermal_calibration_data import AXES, Soak, simulated_soak
from thermal_calibration_study import Trained, differences, means_of_levels, published

from imumon.blocks import BoolArray, FloatArray
from imumon.models.curves.points import Points
from imumon.recordings.reduced import GYRO
from imumon.simulation.unit.scenario import load_scenario
from imumon.simulation.unit.thermal import chamber_log

SOAK = "crs05-soak-chamber"
NEURONS = 2
MEAN_S = 30.0
"""Of the means that the networks are trained on."""
EVERY = 10
"""So many means are one for the network: neighbours on a level say the same."""
AGREE_DEGC = 0.2
"""Wall and case agree: two steps of their logger."""
WINDOW = 31
"""Entries of the log whose median is compared, five minutes: its noise is a tenth of the limit."""
ON_THE_RAMP = np.linspace(27.28, 34.08, 137)
"""°C."""


@dataclass(frozen=True, slots=True, eq=False)
class Chain:
    """What one soak gives for each axis.

    Parameters
    ----------
    samples : int
        Means that had settled.
    bias : tuple of Trained
        Networks on b(T), rad/s, the earth rate in it.
    slope : tuple of Trained
        Networks on the derivative, from level to level, rad/s/°C.
    earth : array (3,)
        Earth rate of the soak, rad/s.
    """

    samples: int
    bias: tuple[Trained, ...]
    slope: tuple[Trained, ...]
    earth: FloatArray

    def value(self, temperature: FloatArray) -> FloatArray:
        """Return the bias of the gyros, rad/s, (n, 3)."""
        return np.column_stack([one.curve.value(temperature) for one in self.bias]) - self.earth

    def derivative(self, temperature: FloatArray) -> FloatArray:
        """Return the derivative of the networks on b(T), rad/s/°C, (n, 3)."""
        return np.column_stack([one.curve.slope(temperature) for one in self.bias])

    def trained_slope(self, temperature: FloatArray) -> FloatArray:
        """Return the networks on the derivative, rad/s/°C, (n, 3)."""
        return np.column_stack([one.curve.value(temperature) for one in self.slope])

    @property
    def filters(self) -> dict[str, Filter]:
        """The filters of the comparison with nothing but what was measured."""
        own = Calibration(self.value, self.derivative)
        trained = Calibration(self.value, self.trained_slope)
        return {
            "ZUPT": Filter("calibrated", temperature="reading", calibration=own),
            "TCZUPT": Filter("fir", 0.5, temperature="reading", calibration=own),
            "TCZUPT, network on the derivative": Filter(
                "fir", 0.5, temperature="reading", calibration=trained
            ),
        }


def run_chain(seed: int, earth: FloatArray) -> Chain:
    """Run a soak and train its networks, with 65/20/15 % of its means."""
    soak = simulated_soak(seed, SOAK)
    points = [settled_means(soak, axis, seed) for axis in range(3)]
    bias = tuple(published(one, NEURONS, seed) for one in points)
    slope = tuple(published(differences(means_of_levels(one)), NEURONS, seed) for one in points)
    return Chain(len(points[0]), bias, slope, earth)


def settled_means(soak: Soak, axis: int, seed: int) -> Points:
    """Return some of the means of a gyro while the log says that the unit has the temperature of the wall."""
    t, value = (
        soak.record.of(name).reshape(-1, round(MEAN_S / 10)).mean(axis=1)
        for name in (f"temperature_{AXES[axis]}", GYRO[axis])
    )
    level = np.argmin(np.abs(t[:, np.newaxis] - soak.centers), axis=1)
    points = Points(t, value, np.ones(len(t)), level)
    return points.only(settled(seed, len(t)) & (np.arange(len(t)) % EVERY == 0))


def settled(seed: int, count: int) -> BoolArray:
    """Return during which means wall and case agreed, as the log has it."""
    time_s, read = chamber_log(load_scenario(SOAK), seed)
    apart = np.lib.stride_tricks.sliding_window_view(read[:, 1] - read[:, 0], WINDOW)
    agree = np.abs(np.median(apart, axis=1)) < AGREE_DEGC
    at = np.searchsorted(time_s[WINDOW - 1 :], (np.arange(count) + 1.0) * MEAN_S, side="right") - 1
    return np.asarray((at >= 0) & agree[at])


def calibration_errors(chains: Sequence[Chain]) -> list[list[str]]:
    """Return rows: rms errors on the temperatures of the ramp, over all chains."""
    truth, slope = curves(ON_THE_RAMP), slopes(ON_THE_RAMP)
    rows = []
    for name, errors in (
        ("bias of the network, deg/h", [one.value(ON_THE_RAMP) - truth for one in chains]),
        ("the same less its mean, deg/h", [_moving(one.value(ON_THE_RAMP) - truth) for one in chains]),
        ("derivative of the network, deg/h/degC", [one.derivative(ON_THE_RAMP) - slope for one in chains]),
        ("network on the derivative, deg/h/degC", [one.trained_slope(ON_THE_RAMP) - slope for one in chains]),
    ):
        by_axis = np.array(errors) / DPH
        rows.append([name, *(f"{rms(by_axis[:, :, j]):.2f}" for j in range(3))])
    return rows


def _moving(errors: FloatArray) -> FloatArray:
    return np.asarray(errors - errors.mean(axis=0))
