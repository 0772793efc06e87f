"""The report of a diagnosis: report.json for programs, and the whole in a few words."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from imumon.effects.base import ACCEL
from imumon.effects.library import separated_by
from imumon.files import plain, write_text
from imumon.lab.diagnosis.blocks import RunBlocks
from imumon.lab.diagnosis.candidates import Candidate
from imumon.lab.diagnosis.choice import Scored
from imumon.lab.diagnosis.diagnose import Diagnosis
from imumon.lab.diagnosis.extended import with_model
from imumon.lab.diagnosis.fit import FittedPart, fit, root_mean_square, score_test
from imumon.lab.diagnosis.likelihood import WALK_S
from imumon.lab.diagnosis.verdict import ChannelVerdict, Claim
from imumon.version import __version__

FORMAT: Final = "imumon-diagnosis/1"
MOST_RANKED = 6
"""Effects in the ranking."""
NOTHING = "nothing"
"""The answer that there is slow noise and no effect."""
MOST_ANSWERS = 2
"""Effects that are tried behind what is unexplained."""
ISOTHERMAL = "at constant temperature, and run imumon allan on that."


def report(diagnosis: Diagnosis, folder: Path | None = None) -> dict[str, Any]:
    """Return the report as it is written into a folder; absent numbers are None."""
    given, survey = diagnosis.model, diagnosis.survey
    content = {
        "format": FORMAT,
        "imumon": __version__,
        "conclusion": conclusion(diagnosis),
        "next": [asdict(next_step(diagnosis, folder))],
        "declared_model": diagnosis.declared if given is None else f"model of {given.created}",
        "block_s": diagnosis.block_s,
        "train": _runs(diagnosis.train),
        "test": _runs(diagnosis.test),
        "independent_test": bool(diagnosis.test) and not diagnosis.held_out,
        "held_out": diagnosis.held_out,
        "temperature_range_degc": [
            survey.middle_degc - survey.half_span_degc,
            survey.middle_degc + survey.half_span_degc,
        ],
        "fastest_degc_per_min": _fastest(diagnosis),
        "caveats": diagnosis.caveats,
        "length_of_gravity": None
        if diagnosis.length is None
        else {name: np.asarray(value).tolist() for name, value in asdict(diagnosis.length).items()},
        "channels": {verdict.name: _channel(verdict) for verdict in diagnosis.verdicts},
    }
    found: dict[str, Any] = plain(content)
    return found


def write_report(diagnosis: Diagnosis, path: Path) -> None:
    """Write report.json; raises OSError when that fails."""
    write_text(path, json.dumps(report(diagnosis, path.parent), indent=2, ensure_ascii=False) + "\n")


def _fastest(diagnosis: Diagnosis) -> float:
    """Return the rate of the temperature that all but a twentieth of the training stays below."""
    rates = [
        np.abs(np.diff(t) / np.diff(run.time_s))
        for run in diagnosis.train
        for t in run.temperature.values()
        if len(run) > 1
    ]
    return 60.0 * float(np.quantile(np.concatenate(rates), 0.95))


def _runs(runs: Sequence[RunBlocks]) -> list[dict[str, Any]]:
    return [{"name": run.name, "blocks": len(run), "duration_s": run.duration_s} for run in runs]


def _channel(verdict: ChannelVerdict) -> dict[str, Any]:
    floor, test, declared = verdict.channel.floor, verdict.test_after, verdict.channel.declared
    sets = [claim.finding.alike for claim in verdict.claims if claim.finding.alike]
    return {
        "verdict": verdict.row.state,
        "unit": verdict.channel.unit,
        "noise_floor_rms": floor.sd,
        "noise_floor_from": floor.source,
        "slow_noise": _slow_noise(verdict),
        "before": {"train_rms": verdict.before.train_rms, "test_rms": verdict.test_before.rms},
        "after": {
            "train_rms": verdict.after.train_rms,
            "test_rms": test.rms,
            "test_rms_tracked": test.estimated_rms,
        },
        "coverage": test.coverage,
        "scored": test.scored,
        "explained_share": verdict.explained,
        "curve": {
            "coefficients": verdict.after.declared.tolist(),
            "sigma": np.sqrt(np.diag(verdict.declared_covariance)).tolist(),
            "middle_degc": declared.middle_degc,
            "half_span_degc": declared.half_span_degc,
        },
        "effects": [_effect(claim) for claim in verdict.claims],
        "ranking": _ranking(verdict),
        "runs": list(_runs_left(verdict)),
        "indistinguishable": sets,
        "to_separate": [
            {"effects": [first, other], "by": separated_by(first, other)}
            for first, *others in sets
            for other in others
        ],
        "questions": _questions(verdict),
        "turns": list(_turns(verdict)),
        "fitted_anew": verdict.refit,
        "left_out": verdict.left_out,
        "in_model_file": verdict.predicts,
        "faults": [fault.text for fault in verdict.channel.faults],
        "unexplained": verdict.unexplained,
        "formula": None,
        "remark": verdict.remark,
        "summary": verdict.summary,
    }


def _slow_noise(verdict: ChannelVerdict) -> dict[str, float]:
    """Return the noise that is likeliest beside what was found: r and q of the likelihood, the same in the
    unit of the channel, and the gain in BIC of innovations with heavy tails over normal ones.

    Flicker and random walk are Gaussian: what jumps or comes in bursts is neither, however slow it is.  Score
    test of Jarque and Bera (1980, doi:10.1016/0165-1765(80)90024-5): n (kurtosis - 3)² / 24.
    """
    found, channel = verdict.found, verdict.found.channel
    flicker, walk = noise = found.fitted(found.model)[1]
    left, _ = found.likelihood.left(channel.values, channel.design(found.model), noise)
    sd = float(np.sqrt(left @ left / len(left)))
    excess = float(np.mean(left**4) / np.mean(left**2) ** 2) - 3.0
    return {
        "flicker": flicker,
        "random_walk": walk,
        "flicker_rms": float(np.sqrt(flicker) * sd),
        "random_walk_per_sqrt_s": float(np.sqrt(walk / WALK_S) * sd),
        "heavy_tails": len(left) * max(excess, 0.0) ** 2 / 24.0 - found.likelihood.price,
    }


def _effect(claim: Claim) -> dict[str, Any]:
    finding = claim.finding
    return {
        "name": finding.name,
        "parameters": _parameters(claim.parts),
        "sigma": [
            {**one.searched, "coefficients": (own[0] if len(own := one.coefficients) == 1 else own).tolist()}
            for one in claim.sigmas
        ],
        "carried_over": any(part.carries for part in claim.parts),
        "evidence": {
            "proven_by": "test" if finding.by_test else "training",
            "gain_bic": finding.gain,
            "test_gain": None,
            "pooled_gain_bic": finding.pooled_gain,
            "rms_explained": claim.size,
            "explained_share_alone": claim.explained,
            "rivals_gain_bic": {name: value for name, value in finding.rivals.items() if value > 0},
        },
        "test_rms_alone": claim.test_alone,
    }


def _parameters(parts: Sequence[FittedPart]) -> dict[str, Any]:
    """Return the parameters of one part as they are, of several as lists."""
    each = []
    for part in parts:
        found = part.effect.model_dump(exclude={"kind", "coefficients"})
        found["coefficients"] = part.own[0].tolist() if not part.runs else part.own.tolist()
        if part.runs:
            found["runs"] = list(part.runs)
        if len(part.start):
            found["start"] = part.start.tolist()
        each.append(found)
    return each[0] if len(each) == 1 else {key: [found.get(key) for found in each] for key in each[0]}


def _leaders(verdict: ChannelVerdict, stage: int) -> list[Scored]:
    """Return the best of each family at a stage of the search, the best of all first."""
    tables = verdict.found.tables
    return sorted(tables[stage].values(), key=lambda one: -one.gain) if tables else []


def _ranking(verdict: ChannelVerdict) -> list[dict[str, Any]]:
    """Return the effects that gain most, with what each leaves alone of training and of the test."""
    ranked = []
    for one in _leaders(verdict, 0)[:MOST_RANKED]:
        fitted = fit(verdict.channel, [one.candidate])
        left = {"train_rms": fitted.train_rms, "test_rms": score_test(verdict.channel, fitted).rms}
        ranked.append({"name": one.family, "gain": one.gain, **left})
    return ranked


def _runs_left(verdict: ChannelVerdict) -> Iterator[dict[str, Any]]:
    """Yield what each run of training and test is left with; NaN where nothing counts."""
    channel, (before, after) = verdict.channel, (verdict.test_before, verdict.test_after)
    ends = np.cumsum([len(run) for run in channel.pool.runs])[:-1]
    training = (np.split(one.train, ends) for one in (verdict.before, verdict.after))
    test = (
        [part[use] for part, use in zip(one.residual, after.counted, strict=True)] for one in (before, after)
    )
    for is_test, runs, left in ((False, channel.pool.runs, training), (True, channel.test, test)):
        for run, first, last in zip(runs, *left, strict=True):
            yield {
                "name": run.name,
                "test": is_test,
                "blocks": len(last),
                "before": root_mean_square(first),
                "after": root_mean_square(last),
                "mean": float(last.mean()) if len(last) else float("nan"),
            }


def _turns(verdict: ChannelVerdict) -> Iterator[dict[str, Any]]:
    """Yield what was done in each stage of the search, and what is left after it, in training and test."""
    rows = [("what was assumed", verdict.before, float("nan"))]
    rows += [(one.done, fit(verdict.channel, one.model), one.gain) for one in verdict.found.stages]
    for done, model, gain in rows:
        left = {"train_rms": model.train_rms, "test_rms": score_test(verdict.channel, model).rms}
        yield {"done": done, "gain_bic": gain, **left}


def _questions(verdict: ChannelVerdict) -> list[list[dict[str, Any]]]:
    """Return what is open, each question as its answers: an effect that may be the one, or `NOTHING`, whether
    it carries over, and the model that has it, fitted to the training, with effects as in a model file."""
    claimed, opened = [finding.candidate for finding in verdict.findings], []
    for finding in verdict.findings:
        if finding.others:
            beside = [other for other in claimed if other is not finding.candidate]
            either = [finding.candidate, *finding.others.values()]
            opened.append([_answer(verdict, beside, one) for one in either])
    if verdict.unexplained and verdict.found.tables:
        tried = [one.candidate for one in _leaders(verdict, -1) if one.fit > 0.0]
        further = [one for one in tried if one not in claimed and _may_be_tried(one)][:MOST_ANSWERS]
        opened.append([_answer(verdict, claimed, one) for one in (None, *further)])
    return opened


def _may_be_tried(candidate: Candidate) -> bool:
    """Return whether a chamber, or poses, can make an effect show itself in another run."""
    inputs = {name for part in candidate.parts for name in part.effect.inputs}
    return candidate.scope in ("shared", "either") and inputs <= {ACCEL}


def _answer(verdict: ChannelVerdict, beside: Sequence[Candidate], one: Candidate | None) -> dict[str, Any]:
    model = fit(verdict.channel, beside if one is None else [*beside, one])
    return {
        "name": NOTHING if one is None else one.family,
        "carries": one is None or one.carries,
        "declared": model.declared.tolist(),
        "effects": [part.effect.model_dump() for part in model.parts if part.carries],
    }


# In a few words


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
    return ". ".join(f"{', '.join(names)}: {text}" for text, names in groups.items())


def next_step(diagnosis: Diagnosis, folder: Path | None) -> NextStep:
    """Return the one thing to do next; `folder` is that of the report, None where there is none."""
    what, why, command = next(_steps(diagnosis, folder or Path()))
    return NextStep(what, why, "" if folder is None else command)


def _steps(diagnosis: Diagnosis, folder: Path) -> Iterator[tuple[str, str, str]]:
    """Yield what there is to do, why, and the command, the most urgent first."""
    verdicts = diagnosis.verdicts

    def which(holds: Callable[[ChannelVerdict], bool]) -> str:
        return ", ".join(one.name for one in verdicts if holds(one))

    if names := which(_of_few_digits):
        what = f"Record {names} again with a range and digits that its noise and bias fit in."
        yield what, "The steps of its values hide what matters.", ""
    if not diagnosis.test or diagnosis.held_out or any(one.by_test for one in verdicts):
        chosen = bool(diagnosis.test) and not diagnosis.held_out
        why = "The test has chosen the effect." if chosen else "Without a test nothing is proven."
        again = " ".join(dict.fromkeys(run.name.partition(",")[0] for run in diagnosis.train))
        command = f"imumon diagnose --train {again} --test NEW --out {folder}"
        yield "Record another session from power-on and test on that.", why, command
    if names := which(lambda one: one.unexplained):
        beside = "what else may drive it (supply, load, pressure, another thermometer)"
        why = "What is left jumps or comes in bursts, as no noise does, or it is slow noise of the unit."
        yield f"Record {names} beside {beside}, {ISOTHERMAL}", why, ""
    sets = (one.finding.alike for verdict in verdicts for one in verdict.claims)
    if alike := next(filter(None, sets), []):
        why = f"{alike[0]} and {alike[1]} fit these recordings alike, and predict others differently."
        command = f"imumon plan {folder} --out {folder / 'next'}"
        yield f"Record {separated_by(alike[0], alike[1])}.", why, command
    if useful := [one for one in with_model(diagnosis) if one.claims and one.predicts]:
        least = min(one.test_after.rms / one.test_before.rms for one in useful)
        what = f"Use the model with what is named of {', '.join(one.name for one in useful)}."
        command = f"imumon monitor PORT --device NAME --model {folder / 'model.yaml'}"
        yield what, f"Errors in the test fall by up to {1.0 - least:.0%}.", command
    if names := which(lambda one: one.row.state == "not proven"):
        why = "What is left is little, noise or an effect too small to prove."
        yield f"Record {names} {ISOTHERMAL}", why, ""
    yield "Nothing has to be added.", "The declared model is enough on these recordings.", ""


def _of_few_digits(verdict: ChannelVerdict) -> bool:
    channel, unproven = verdict.channel, verdict.row.state == "not proven"
    return verdict.faulty or verdict.hidden or (unproven and bool(channel.test) and channel.coarse)
