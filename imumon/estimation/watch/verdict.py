"""From the tests to words: what the innovations follow, which effects would do that, what to run."""

from __future__ import annotations

from dataclasses import dataclass

from imumon.blocks import FloatArray
from imumon.effects.library import suspected_by
from imumon.estimation.watch import evidence

SHARE = 0.5
"""What has less than this share of the strongest evidence explains nothing."""
ALIKE = 0.8
"""What has this share of the strongest evidence among its like is named with it."""
DIAGNOSE = "imumon diagnose --train SESSION --out DIR"
DIAGNOSE_MODEL = "imumon diagnose --train SESSION --model SESSION --out DIR"
"""A session that ran with a model has it."""
CALIBRATE = "imumon calibrate SESSION --out MODEL.yaml"
ALLAN = "imumon allan SESSION"


@dataclass(frozen=True, slots=True)
class Trait:
    """Something the innovations may do that they should not."""

    text: str
    """What they do, after "the innovations". An effect that would make them do so has it in
    `suspected_by`."""
    first: int
    stop: int
    """The regressors of `evidence` that find it."""


TEMPERATURE = Trait("temperature", evidence.TEMPERATURE, evidence.RATE_HIGH)
RATE = Trait("temperature rate", evidence.RATE_HIGH, evidence.CONSTANT)
TIME = Trait("time since start", evidence.CONSTANT, evidence.PAST)
DRIVERS = (TEMPERATURE, RATE, TIME)
PAST = Trait("follow each other", evidence.PAST, evidence.REGRESSORS)
SIZE = Trait("exceed their standard deviation", evidence.REGRESSORS, evidence.REGRESSORS + 1)


@dataclass(frozen=True, slots=True)
class Verdict:
    """What is suspected: a short reason, and a line for the log."""

    reason: str
    notice: str


def judge(peaks: FloatArray, modelled: bool) -> Verdict:
    """Return what the evidence says, once there is an alarm.

    What drives the bias is named before the mere fact that innovations follow each other, and that before
    their size: an effect does all three.

    Parameters
    ----------
    peaks : array (3, 13)
        Evidence of each axis and regressor, in natural logarithms.
    modelled : bool
        Whether a bias model is in use.
    """
    best = float(peaks.max())
    strength = {trait: _strength(peaks, trait) for trait in (*DRIVERS, PAST, SIZE)}
    strongest = max(strength[trait] for trait in DRIVERS)
    if strongest >= SHARE * best:
        named = [trait for trait in DRIVERS if strength[trait] >= ALIKE * strongest]
        does = f"follow {' or '.join(trait.text for trait in named)}"
    else:
        named = [PAST if strength[PAST] >= SHARE * best else SIZE]
        does = named[0].text
    axes = _axes(peaks, named, best)
    start = f"MODEL SUSPECT: on {axes} the innovations of the bias filter {does}"
    if named == [SIZE]:
        text = f"the noise declared is too small, or something shakes the unit: {ALLAN}"
        return Verdict(f"innovations {does}", f"{start}; {text}")
    if not modelled and TIME not in named and PAST not in named:
        text = f"the bias follows temperature, and there is no model: {CALIBRATE}"
        return Verdict("bias follows temperature", f"{start}; {text}")
    effects = list(dict.fromkeys(effect for trait in named for effect in suspected_by(trait.text)))
    if not modelled and TIME in named and len(named) > 1:
        text = f"there is no model of the bias over temperature: {CALIBRATE}; if that leaves something, of"
        return Verdict(f"innovations {does}", f"{start}; {text} {_either(effects)}: {DIAGNOSE}")
    diagnose = DIAGNOSE_MODEL if modelled else DIAGNOSE
    lacks = "the model lacks an effect such as" if modelled else "there may be an effect such as"
    return Verdict(f"innovations {does}", f"{start}; {lacks} {_either(effects)}: {diagnose}")


def _strength(peaks: FloatArray, trait: Trait) -> float:
    return float(peaks[:, trait.first : trait.stop].max())


def _axes(peaks: FloatArray, named: list[Trait], best: float) -> str:
    """Return the axes with evidence for one of these traits."""
    found = [
        axis
        for axis, row in zip("xyz", peaks, strict=True)
        if max(row[trait.first : trait.stop].max() for trait in named) >= SHARE * best
    ]
    return ", ".join(found)


def _either(names: list[str]) -> str:
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} or {names[-1]}"
