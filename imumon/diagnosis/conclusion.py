"""A diagnosis in a few words: what each channel lacks, and what to do next."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from imumon.diagnosis.engine import Diagnosis
from imumon.diagnosis.extended import with_model
from imumon.diagnosis.fit import MATERIAL
from imumon.diagnosis.verdict import BY_TEST, TOO_FEW, ChannelVerdict
from imumon.effects.library import separated_by

WELL_COVERED = 0.9
"""Share of a test inside what training covered below which that is said on the first screen."""
ISOTHERMAL = (
    "a recording at constant temperature, and imumon allan of that, tell whether it is noise of the unit."
)
DRIVEN = (
    "record what else may drive it (supply, load, pressure, another thermometer) and train on that as well;"
    " whatever is recorded is tried."
)
State = Literal["named", "unexplained", "nothing missing", "too few digits", "not proven", "faulty"]


@dataclass(frozen=True, slots=True)
class NextStep:
    """What to do, and the command for it; empty where there is none."""

    what: str
    command: str = ""


def state(verdict: ChannelVerdict) -> State:
    """Return which kind of verdict it is."""
    if np.isinf(verdict.channel.blind):
        return "faulty"
    if verdict.claims:
        return "named"
    if verdict.unexplained:
        return "unexplained"
    if verdict.hidden:
        return "too few digits"
    test = verdict.test_after
    clean = test is not None and test.rms < MATERIAL * verdict.channel.floor.sd
    return "nothing missing" if clean else "not proven"


def in_short(verdict: ChannelVerdict) -> str:
    """Return what a channel lacks in a few words."""
    kind = state(verdict)
    if kind == "named":
        names = [" or ".join(claim.finding.alike) or claim.finding.name for claim in verdict.claims]
        said = " and ".join(dict.fromkeys(names))
        if verdict.unexplained:
            return f"{said}, and more that is unexplained"
        return f"{said}; {TOO_FEW} whether there is more" if verdict.hidden else said
    if kind == "faulty":
        return "the data is at fault"
    said = {"not proven": "nothing is proven", "too few digits": TOO_FEW}.get(kind, kind)
    if verdict.left_out:
        refuted = " and ".join(dict.fromkeys(item["name"] for item in verdict.left_out))
        said += f"; the test refutes {refuted}"
    return said


def conclusion(diagnosis: Diagnosis) -> str:
    """Return the whole in a line: what is said of which channels."""
    groups: dict[str, list[str]] = {}
    for verdict in diagnosis.verdicts:
        groups.setdefault(in_short(verdict), []).append(verdict.name)
    return ". ".join(f"{_together(names)}: {said}" for said, names in groups.items())


def keep_in_mind(diagnosis: Diagnosis) -> list[str]:
    """Return what limits the verdicts, then what is to be said of the data."""
    said = []
    verdicts = diagnosis.verdicts
    if by_test := [one.name for one in verdicts if any(claim.finding.by_test for claim in one.claims)]:
        said.append(f"{_together(by_test)}: {BY_TEST}")
    little = [
        one for one in verdicts if one.test_after is not None and one.test_after.coverage < WELL_COVERED
    ]
    if little:
        least = min(one.test_after.coverage for one in little if one.test_after is not None)
        said.append(f"only {least:.0%} of the test is inside what training covered; the rest proves nothing")
    if any(state(one) == "named" for one in verdicts):
        said.append(
            "a name is the shape that fits, not a cause that was seen: what else has that shape is called so"
        )
    if any(state(one) == "unexplained" and not one.slow.jumps for one in verdicts):
        said.append("unexplained is structure, or slow noise, which what was recorded does not tell from it")
    return [*said, *diagnosis.caveats]


def _together(names: Sequence[str]) -> str:
    """Return names in short: gyro_x, y, z."""
    found: list[str] = []
    for name in names:
        stem, _, axis = name.rpartition("_")
        follows = found and stem and found[-1].rpartition(", ")[0].startswith(f"{stem}_")
        first = found and stem and found[-1].rpartition("_")[0] == stem
        if follows or first:
            found[-1] += f", {axis}"
        else:
            found.append(name)
    return " and ".join(found)


def next_steps(diagnosis: Diagnosis, folder: Path | None) -> list[NextStep]:
    """Return what to do next; `folder` is that of the report, None where there is none."""
    verdicts, steps = diagnosis.verdicts, list[NextStep]()
    plan = "" if folder is None else f"imumon plan {folder} --out {folder / 'next'}"
    asked = [question for verdict in with_model(diagnosis) for question in verdict.questions]
    for pair in _not_told(verdicts):
        steps.append(NextStep(f"To tell {pair[0]} from {pair[1]}, record {separated_by(*pair)}."))
    unexplained = [one for one in verdicts if state(one) == "unexplained"]
    if jumping := [one.name for one in unexplained if one.slow.jumps]:
        what = f"What is left of {_together(jumping)} jumps or comes in bursts, as no noise does: {DRIVEN}"
        steps.append(NextStep(what))
    if noisy := [one.name for one in unexplained if not one.slow.jumps]:
        what = f"What is left of {_together(noisy)} moves as slow noise does: {ISOTHERMAL}"
        steps.append(NextStep(f"{what} If the unit has less of that, {DRIVEN}"))
    open_ends = [one for one in verdicts if state(one) == "not proven" and one.test_after is not None]
    if small := [one.name for one in open_ends if not one.channel.coarse]:
        steps.append(NextStep(f"What is left of {_together(small)} is little: {ISOTHERMAL}"))
    coarse = [one for one in open_ends if one.channel.coarse]
    if faulty := [one.name for one in verdicts if state(one) == "faulty" or one.hidden or one in coarse]:
        what = f"Record {_together(faulty)} again with a range and digits that its noise and bias fit in."
        steps.append(NextStep(what))
    if asked and plan:
        steps.append(NextStep("The shortest experiment that answers what is open:", plan))
    if not diagnosis.test or diagnosis.held_out:
        again = " ".join(dict.fromkeys(_session(run.name) for run in diagnosis.train))
        command = f"imumon diagnose --train {again} --test NEW --out {folder}"
        steps.append(
            NextStep("For a proof, record another session from power-on:", command if folder else "")
        )
    useful = [verdict for verdict in with_model(diagnosis) if verdict.claims and verdict.predicts]
    if useful and folder is not None:
        what = f"Use the model with what is named of {_together([verdict.name for verdict in useful])}:"
        steps.append(NextStep(what, f"imumon monitor PORT --device NAME --model {folder / 'model.yaml'}"))
    if all(state(verdict) == "nothing missing" for verdict in verdicts) and not steps:
        steps.append(NextStep("Nothing has to be added: the declared model is enough on these recordings."))
    return steps


def _not_told(verdicts: Sequence[ChannelVerdict]) -> list[tuple[str, str]]:
    """Return the pairs of effects that are not told apart, each once."""
    pairs = {
        (claim.finding.alike[0], other): tuple(sorted((claim.finding.alike[0], other)))
        for verdict in verdicts
        for claim in verdict.claims
        for other in claim.finding.alike[1:]
    }
    return list({key: pair for pair, key in pairs.items()}.values())


def _session(name: str) -> str:
    return name.partition(",")[0]
