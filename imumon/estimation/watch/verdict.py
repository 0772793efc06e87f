"""Cause and advice in words from the test statistics: which quantity the innovations follow, and why."""

from __future__ import annotations

from imumon.blocks import FloatArray
from imumon.effects.library import suspected_by
from imumon.estimation.watch.evidence import PATTERNS, Pattern

EXPLAINING_SHARE = 0.5
"""A pattern with less than this share of the strongest evidence does not explain it."""
COMPARABLE_SHARE = 0.8
"""A driver with this share of the evidence of the strongest driver is named with it."""


def interpret(peaks: FloatArray, modelled: bool) -> tuple[str, str]:
    """Return a short reason and a line for the log, with a bias model in use or not.

    What drives the bias is named before the mere fact that innovations follow each other, and that before
    their size: an effect does all three.

    Parameters
    ----------
    peaks : array (3, k)
        Of `State`.
    """
    least = EXPLAINING_SHARE * float(peaks.max())
    strength = {pattern: float(peaks[:, pattern == PATTERNS].max()) for pattern in Pattern}
    drivers = (Pattern.TEMPERATURE, Pattern.RATE, Pattern.TIME)
    strongest = max(strength[driver] for driver in drivers)
    if strongest >= least:
        named = [driver for driver in drivers if strength[driver] >= COMPARABLE_SHARE * strongest]
        does = f"follow {' or '.join(named)}"
    else:
        named = [Pattern.AUTOCORRELATION if strength[Pattern.AUTOCORRELATION] >= least else Pattern.VARIANCE]
        does = named[0]
    shown = [pattern in named for pattern in PATTERNS]
    axes = ", ".join(axis for axis, of in zip("xyz", peaks[:, shown].max(1), strict=True) if of >= least)
    thermal = set(named) <= {Pattern.TEMPERATURE, Pattern.RATE}
    reason = "bias follows temperature" if thermal and not modelled else f"innovations {does}"
    start = f"MODEL SUSPECT: on {axes} the innovations of the bias filter {does}"
    return reason, f"{start}; {_advice(named, thermal, modelled)}"


def _advice(named: list[Pattern], thermal: bool, modelled: bool) -> str:
    """Return what may be the cause, and which command tests it."""
    calibrate = "imumon calibrate SESSION --out MODEL.yaml"
    effects = list(dict.fromkeys(effect for pattern in named for effect in suspected_by(pattern)))
    either = " or ".join([", ".join(effects[:-1]), *effects[-1:]] if len(effects) > 1 else effects)
    diagnose = f"imumon diagnose --train SESSION{' --model SESSION' * modelled} --out DIR"
    if named == [Pattern.VARIANCE]:
        return "the noise declared is too small, or something shakes the unit: imumon allan SESSION"
    if modelled:  # a session that ran with a model has it
        return f"the model lacks an effect such as {either}: {diagnose}"
    if thermal:
        return f"the bias follows temperature, and there is no model: {calibrate}"
    if Pattern.TIME in named and len(named) > 1:
        text = f"there is no model of the bias over temperature: {calibrate}; if that leaves something, of"
        return f"{text} {either}: {diagnose}"
    return f"there may be an effect such as {either}: {diagnose}"
