"""The warm-up of the accelerometers as a bias model knows it from earlier recordings."""

from __future__ import annotations

from imumon.effects.warm_up import WarmUp
from imumon.estimation.alignment.parameters import KnownWarmUp
from imumon.geodesy import MICRO_G
from imumon.models.model import BiasModel

NO_MATTER_S = 1.0
"""Time constant that stands where there is no warm-up."""


def known_warm_up(model: BiasModel | None) -> KnownWarmUp | None:
    """Return the warm-up of a model's accelerometers, or None when it has none.

    The effect adds c exp(-t / T) to a bias, which is a warm-up by -c.  How well it is known is judged by the
    channel's residual, unless an accelerometer has other effects: it may drift by these.
    """
    amplitude, constant, residuals, others = [0.0] * 3, [NO_MATTER_S] * 3, [], False
    for i, axis in enumerate("xyz"):
        channel = None if model is None else model.channels.get(f"accel_{axis}")
        for effect in channel.effects if channel is not None else ():
            if isinstance(effect, WarmUp) and channel is not None:
                amplitude[i] = -effect.coefficients[0] / MICRO_G
                constant[i] = effect.time_constant_s
                residuals.append(channel.residual_sd / MICRO_G)
            else:
                others = True
    if not residuals:
        return None
    return KnownWarmUp(
        amplitude_ug=amplitude,
        time_constant_s=constant,
        amplitude_sd_ug=None if others else max(residuals) or None,
    )
