"""A diagnosis in a few words: what each channel lacks, and the one thing to do next."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from imumon.effects.library import separated_by
from imumon.lab.diagnosis.diagnose import Diagnosis
from imumon.lab.diagnosis.extended import with_model
from imumon.lab.diagnosis.verdict import ChannelVerdict

WELL_COVERED = 0.9
"""Share of a test inside what training covered below which the first screen has it."""


@dataclass(frozen=True, slots=True)
class NextStep:
    """What to do and why, and the command for it; empty where there is none."""

    what: str
    why: str
    command: str = ""


def conclusion(diagnosis: Diagnosis) -> str:
    """Return the whole in a line: the verdicts, each with its channels."""
    groups: dict[str, list[str]] = {}
    for verdict in diagnosis.verdicts:
        groups.setdefault(verdict.in_short, []).append(verdict.name)
    return ". ".join(f"{_together(names)}: {text}" for text, names in groups.items())


def keep_in_mind(diagnosis: Diagnosis) -> list[str]:
    """Return what limits the verdicts, then the caveats of the data."""
    limits, verdicts = [], diagnosis.verdicts
    least = min((one.test_after.coverage for one in verdicts), default=1.0)
    if least < WELL_COVERED:
        limits.append(
            f"only {least:.0%} of the test is inside what training covered; the rest proves nothing"
        )
    if any(one.claims for one in verdicts):
        limits.append("a name is the shape that fits, not its cause: what else has that shape has that name")
    if any(one.row.state == "unexplained" and not one.slow.jumps for one in verdicts):
        limits.append("unexplained is structure, or slow noise, which these recordings do not tell from it")
    return [*limits, *diagnosis.caveats]


def _together(names: Sequence[str]) -> str:
    """Return names in short: gyro_x, y, z."""
    sensors: dict[str, list[str]] = {}
    for name in names:
        sensor, _, axis = name.rpartition("_")
        sensors.setdefault(sensor if len(axis) == 1 else name, []).append(axis)
    texts = [
        f"{sensor}_{', '.join(axes)}" if sensor not in names else sensor for sensor, axes in sensors.items()
    ]
    return " and ".join(texts)


def next_step(diagnosis: Diagnosis, folder: Path | None) -> NextStep:
    """Return the one thing to do next; `folder` is that of the report, None where there is none."""
    return next(_steps(diagnosis, folder))


def _steps(diagnosis: Diagnosis, folder: Path | None) -> Iterator[NextStep]:
    """Yield what there is to do, the most urgent first."""
    verdicts = diagnosis.verdicts

    def which(holds: Callable[[ChannelVerdict], bool]) -> str:
        return _together([one.name for one in verdicts if holds(one)])

    if names := which(_of_few_digits):
        what = f"Record {names} again with a range and digits that its noise and bias fit in."
        yield NextStep(what, "The steps of its values hide what matters.")
    if not diagnosis.test or diagnosis.held_out or any(one.by_test for one in verdicts):
        chosen = bool(diagnosis.test) and not diagnosis.held_out
        why = "The test has chosen the effect." if chosen else "Without a test nothing is proven."
        again = " ".join(dict.fromkeys(run.name.partition(",")[0] for run in diagnosis.train))
        command = "" if folder is None else f"imumon diagnose --train {again} --test NEW --out {folder}"
        yield NextStep("Record another session from power-on and test on that.", why, command)
    if names := which(lambda one: one.unexplained and one.slow.jumps):
        what = f"Record beside {names} what else may drive it (supply, load, pressure, another thermometer)."
        yield NextStep(what, "What is left jumps or comes in bursts, as no noise does.")
    isothermal = "at constant temperature, and run imumon allan on that."
    if names := which(lambda one: one.unexplained):
        why = "What is left moves as slow noise does: that shows whether the unit has it."
        yield NextStep(f"Record {names} {isothermal}", why)
    sets = (one.finding.alike for verdict in verdicts for one in verdict.claims)
    if alike := next(filter(None, sets), []):
        command = "" if folder is None else f"imumon plan {folder} --out {folder / 'next'}"
        why = f"{alike[0]} and {alike[1]} fit these recordings alike, and predict others differently."
        yield NextStep(f"Record {separated_by(alike[0], alike[1])}.", why, command)
    if useful := [one for one in with_model(diagnosis) if one.claims and one.predicts]:
        least = min(one.test_after.rms / one.test_before.rms for one in useful)
        what = f"Use the model with what is named of {_together([one.name for one in useful])}."
        command = (
            "" if folder is None else f"imumon monitor PORT --device NAME --model {folder / 'model.yaml'}"
        )
        yield NextStep(what, f"Errors in the test fall by up to {1.0 - least:.0%}.", command)
    if names := which(lambda one: one.row.state == "not proven"):
        why = "What is left is little, noise or an effect too small to prove."
        yield NextStep(f"Record {names} {isothermal}", why)
    yield NextStep("Nothing has to be added.", "The declared model is enough on these recordings.")


def _of_few_digits(verdict: ChannelVerdict) -> bool:
    channel, unproven = verdict.channel, verdict.row.state == "not proven"
    return verdict.faulty or verdict.hidden or (unproven and bool(channel.test) and channel.coarse)
