"""Parameters of the alignment in a pipeline file, and the warm-up of a bias model."""

from __future__ import annotations

import math
from typing import Annotated, Any, NamedTuple

import numpy as np
from pydantic import Field, field_validator

from imumon.blocks import FloatArray
from imumon.config import StrictModel
from imumon.effects.since_power_on import WarmUp
from imumon.estimation.rest.parameters import Retired
from imumon.geodesy import MICRO_G
from imumon.models.model import BiasModel

_Micro = Annotated[float, Field(ge=-1e5, le=1e5)]
_Seconds = Annotated[float, Field(gt=0.0, le=1e5)]


class RemainingWarmUp(NamedTuple):
    """Warm-up of the accelerometers: standard deviation of its amplitudes, g, and their time constants, s."""

    sd: float = 1e-4
    tau_s: tuple[float, ...] = (100.0, 300.0, 1000.0)


class KnownWarmUp(StrictModel):
    """Accelerometer bias after power-on, known from earlier recordings: amplitude (1 - exp(-t / tau)).

    Parameters
    ----------
    amplitude_ug : [x, y, z]
        Final value in body axes, µg.
    time_constant_s : [x, y, z], or a float for all
    amplitude_sd_ug, time_constant_sd_s : float
        Standard deviations, when they are known: a change of the horizon that they do not explain is then a
        tilt of the unit.
    """

    amplitude_ug: Annotated[list[_Micro], Field(min_length=3, max_length=3)]
    time_constant_s: Annotated[list[_Seconds], Field(min_length=3, max_length=3)]
    amplitude_sd_ug: float | None = Field(default=None, gt=0.0, le=1e5)
    time_constant_sd_s: float = Field(default=0.0, ge=0.0, le=1e5)

    def bias_g(self, time_s: FloatArray) -> FloatArray:
        """Return the bias at times since the first sample, s, (n,), in body axes, g, (n, 3)."""
        course = -np.expm1(-time_s[:, None] / np.array(self.time_constant_s))
        return np.asarray(1e-6 * course * np.array(self.amplitude_ug))

    @property
    def remaining(self) -> RemainingWarmUp:
        """What remains of the warm-up when this is subtracted; that of any unit if no sd is given."""
        if self.amplitude_sd_ug is None:
            return RemainingWarmUp()
        pairs = list(zip(self.time_constant_s, self.amplitude_ug, strict=True))
        largest, mean_s = max(abs(size) for _, size in pairs), sum(self.time_constant_s) / len(pairs)
        sd_ug = math.hypot(self.amplitude_sd_ug, self.time_constant_sd_s / mean_s * largest)
        return RemainingWarmUp(1e-6 * sd_ug, tuple(sorted({tau_s for tau_s, size in pairs if size})))

    @field_validator("time_constant_s", mode="before")
    @classmethod
    def _of_all(cls, given: Any) -> Any:
        return [given] * 3 if isinstance(given, int | float) else given


class AlignmentParameters(StrictModel):
    """Parameters of the heading estimation; every key has a default.

    Parameters
    ----------
    settled_deg : float
        The heading is settled when its sigma is at most this.
    observable_deg : float
        A heading with a larger sigma is not shown.  That of a MEMS gyro whose bias happens to be small is 7
        to 12 degrees.
    gyro_bias_sd_deg_per_h : float, optional
        Standard deviation of a gyro's bias, from run to run.  Without it, the prior is a
        regression on the noise, and the data weigh its size by how well the rate fits the earth's.
    gyro_flicker_deg_per_h : float, optional
        Standard deviation by which the bias changes from position to position: the bias instability.
    gyro_scale_sd_ppm : float, optional
        Standard deviation of a gyro's scale factor and misalignment: the relative
        error of a turn between two positions.  Default: a regression on the noise, and 300 at least.
    accel_bias_sd_ug : float, optional
        Standard deviation of the constant bias of an accelerometer; it tilts the horizon.  Default:
        a regression on the noise of the gyros, and 750 at least.
    known_warm_up : KnownWarmUp, optional
        Counted from the first sample of the device.
    coarse_s, corner_hz, damping
        Not used any more: the published loop has the values of its paper.
    """

    settled_deg: float = Field(default=0.05, gt=0.0, le=90.0)
    observable_deg: float = Field(default=5.0, gt=0.0, le=60.0)
    gyro_bias_sd_deg_per_h: float | None = Field(default=None, ge=0.0, le=1e5)
    gyro_flicker_deg_per_h: float | None = Field(default=None, ge=0.0, le=1e5)
    gyro_scale_sd_ppm: float | None = Field(default=None, ge=0.0, le=1e5)
    accel_bias_sd_ug: float | None = Field(default=None, ge=0.0, le=1e5)
    known_warm_up: KnownWarmUp | None = None
    coarse_s: Retired = None
    corner_hz: Retired = None
    damping: Retired = None


def known_warm_up(model: BiasModel | None) -> KnownWarmUp | None:
    """Return the warm-up of a model's accelerometers, or None when it has none.

    The effect adds c exp(-t / T) to a bias, which is a warm-up by -c.  How well it is known follows
    from the channel's residual, unless an accelerometer has other effects: it may drift by these.
    """
    amplitude, constant = [0.0] * 3, [1.0] * 3  # s: of no matter where there is no warm-up
    residual_sds, has_others = [], False
    for i, axis in enumerate("xyz"):
        channel = None if model is None else model.channels.get(f"accel_{axis}")
        if channel is None:
            continue
        for effect in channel.effects:
            if isinstance(effect, WarmUp):
                amplitude[i], constant[i] = -effect.coefficients[0] / MICRO_G, effect.time_constant_s
                residual_sds.append(channel.residual_sd)
            else:
                has_others = True
    if not residual_sds:
        return None
    return KnownWarmUp(
        amplitude_ug=amplitude,
        time_constant_s=constant,
        amplitude_sd_ug=None if has_others else max(residual_sds) / MICRO_G or None,
    )
