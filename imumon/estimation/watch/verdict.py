"""Cause and advice in words from the test statistics: which quantity the innovations follow, and why."""

from __future__ import annotations

from typing import NamedTuple

from imumon.blocks import FloatArray
from imumon.effects.library import suspected_by
from imumon.estimation.watch.evidence import Trait, columns_of

SHARE, ALIKE = 0.5, 0.8
"""What has less than this share of the strongest evidence explains nothing; what has this share of the
strongest driver is named with it."""


class Verdict(NamedTuple):
    """What is suspected: a short reason, and a line for the log."""

    reason: str
    notice: str


def interpret(peaks: FloatArray, modelled: bool) -> Verdict:
    """Return cause and advice for the peaks of the tests (`State.peaks`), with a bias model in use or not.

    What drives the bias is named before the mere fact that innovations follow each other, and that before
    their size: an effect does all three.
    """
    best = float(peaks.max())
    strength = {trait: float(peaks[:, columns_of(trait)].max()) for trait in Trait}
    drivers = (Trait.TEMPERATURE, Trait.RATE, Trait.TIME)
    strongest = max(strength[trait] for trait in drivers)
    if strongest >= SHARE * best:
        named = [trait for trait in drivers if strength[trait] >= ALIKE * strongest]
        does = f"follow {' or '.join(named)}"
    else:
        named = [Trait.PAST if strength[Trait.PAST] >= SHARE * best else Trait.SIZE]
        does = named[0]
    evidence = peaks[:, [column for trait in named for column in columns_of(trait)]].max(1)
    axes = ", ".join(axis for axis, of in zip("xyz", evidence, strict=True) if of >= SHARE * best)
    start = f"MODEL SUSPECT: on {axes} the innovations of the bias filter {does}"
    thermal = not {Trait.TIME, Trait.PAST, Trait.SIZE} & set(named)
    reason = "bias follows temperature" if thermal and not modelled else f"innovations {does}"
    return Verdict(reason, f"{start}; {_advice(named, thermal, modelled)}")


def _advice(named: list[Trait], thermal: bool, modelled: bool) -> str:
    """Return what may be the cause, and which command tests it."""
    calibrate = "imumon calibrate SESSION --out MODEL.yaml"
    effects = list(dict.fromkeys(effect for trait in named for effect in suspected_by(trait)))
    either = f"{', '.join(effects[:-1])} or {effects[-1]}" if len(effects) > 1 else "".join(effects)
    diagnose = f"imumon diagnose --train SESSION{' --model SESSION' * modelled} --out DIR"
    if named == [Trait.SIZE]:
        return "the noise declared is too small, or something shakes the unit: imumon allan SESSION"
    if modelled:  # a session that ran with a model has it
        return f"the model lacks an effect such as {either}: {diagnose}"
    if thermal:
        return f"the bias follows temperature, and there is no model: {calibrate}"
    if Trait.TIME in named and len(named) > 1:
        text = f"there is no model of the bias over temperature: {calibrate}; if that leaves something, of"
        return f"{text} {either}: {diagnose}"
    return f"there may be an effect such as {either}: {diagnose}"
