"""The report of a diagnosis: report.json for programs, and the conclusion and next step in words."""

import json
import shlex
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from imumon.effects.base import ACCEL as ACCEL_DRIVER
from imumon.effects.library import separated_by
from imumon.files import plain, write_text
from imumon.version import __version__

from ..calibration.cells import ONE_WAY
from .candidates import Candidate, root_mean_square
from .claims import explained_share
from .diagnose import Diagnosis
from .extended import with_model
from .fit import Fit, FittedPart, fit, score_test
from .likelihood import WALK_S
from .runs import unit_of
from .verdict import ChannelVerdict, Claim

Content = dict[str, Any]
NOTHING = "nothing"  # the answer that there is slow noise and no effect
ISOTHERMAL = "at constant temperature, and run imumon allan on that."


def report(diagnosis: Diagnosis, folder: Path | None = None) -> Content:
    """Return the report as it is written into a folder; absent numbers are None."""
    present, scale, length = diagnosis.model, diagnosis.verdicts[0].channel.scale, diagnosis.length
    every = [(run.time_s, t) for run in diagnosis.train for t in run.temperature.values()]
    rates = np.concatenate([np.abs(np.diff(t) / np.diff(time_s)) for time_s, t in every])
    content = {
        "format": "imumon-diagnosis/1",
        "imumon": __version__,
        "conclusion": conclusion(diagnosis),
        "next": [next_step(diagnosis, folder)._asdict()],
        "declared_model": f"model of {present.created}" if present else diagnosis.declared,
        "block_s": diagnosis.train[0].block_s,
        **{
            key: [
                {"name": run.in_slots.name, "blocks": len(run), "duration_s": run.in_slots.duration_s}
                for run in runs
            ]
            for key, runs in (("train", diagnosis.train), ("test", diagnosis.test))
        },
        "independent_test": bool(diagnosis.test) and not diagnosis.held_out,
        "held_out": diagnosis.held_out,
        "temperature_range_degc": [scale.middle - scale.half_span, scale.middle + scale.half_span],
        # The 95 % quantile (assumed): single steps of a coarse thermometer are faster.
        "fastest_degc_per_min": 60.0 * np.quantile(rates, 0.95),
        "caveats": diagnosis.caveats,
        "length_of_gravity": length and {key: np.asarray(v).tolist() for key, v in length._asdict().items()},
        "channels": {verdict.name: _channel(verdict) for verdict in diagnosis.verdicts},
    }
    return dict(plain(content))


def write_report(diagnosis: Diagnosis, path: Path) -> None:
    """Write report.json; raises OSError when that fails."""
    write_text(path, json.dumps(report(diagnosis, path.parent), indent=2, ensure_ascii=False) + "\n")


def _channel(verdict: ChannelVerdict) -> Content:
    channel, before, after = verdict.channel, verdict.test_before, verdict.prediction
    estimated_rms = verdict.test_after.estimated_rms
    sets = [claim.finding.names for claim in verdict.claims if claim.finding.alternatives]
    train_before, train_after = verdict.before.train_rms, verdict.after.train_rms
    apart = [(first, other) for first, *others in sets for other in others]
    ranked = sorted(verdict.search.tables[0].values(), key=lambda scored: -scored.gain)[:6]
    steps = [("what was assumed", verdict.before, np.nan)]
    steps += [(done, fit(channel, model), gain) for done, model, gain in verdict.search.history]
    return {
        "verdict": verdict.row.state,
        "unit": unit_of(channel.name),
        "noise_floor_rms": channel.floor.sd,
        "noise_floor_from": channel.floor.source,
        "slow_noise": _slow_noise(verdict),
        "before": {"train_rms": train_before, "test_rms": before.rms},
        "after": {"train_rms": train_after, "test_rms": after.rms, "test_rms_tracked": estimated_rms},
        "coverage": after.coverage,
        "scored": after.scored_share,
        "explained_share": (
            explained_share(train_before, train_after, channel.total_floor) if verdict.claims else 0.0
        ),
        "curve": {
            "coefficients": verdict.after.declared.tolist(),
            "sigma": np.sqrt(np.diag(verdict.declared_covariance)).tolist(),
            "middle_degc": channel.scale.middle,
            "half_span_degc": channel.scale.half_span,
        },
        "effects": [_effect(verdict, claim) for claim in verdict.claims],
        "ranking": [
            {"name": one.candidate.family, "gain": one.gain, **_left(verdict, _alone(verdict, one.candidate))}
            for one in ranked
        ],
        "runs": list(_runs_left(verdict)),
        "indistinguishable": sets,
        "to_separate": [{"effects": [*pair], "by": separated_by(*pair)} for pair in apart],
        "questions": _questions(verdict),
        "turns": [{"done": done, "gain_bic": gain, **_left(verdict, model)} for done, model, gain in steps],
        "refused": verdict.search.refused,
        "fitted_anew": verdict.refit,
        "left_out": verdict.left_out,
        "in_model_file": verdict.predicts,
        "faults": [*channel.faults],
        "unexplained": verdict.unexplained,
        "formula": None,  # always, as the format has it
        "remark": verdict.remark,
        "summary": verdict.summary,
    }


def _slow_noise(verdict: ChannelVerdict) -> dict[str, float]:
    """Return the noise that is likeliest beside what was found: r and q of the likelihood, the same in the
    unit of the channel, and the gain in BIC of innovations with heavy tails over normal ones."""
    # Flicker and random walk are Gaussian: what jumps or comes in bursts is neither, however slow it is.
    # Score test of Jarque and Bera (1980, doi:10.1016/0165-1765(80)90024-5): n (kurtosis - 3)² / 24.
    search, channel = verdict.search, verdict.search.channel
    flicker, walk = noise = search.maximum(search.model)[1]
    residual, _ = search.likelihood.v_and_q(channel.y, channel.design(search.model), noise)
    sd = np.sqrt(residual @ residual / len(residual))
    excess = float(np.mean(residual**4) / np.mean(residual**2) ** 2) - 3.0
    return {
        "flicker": flicker,
        "random_walk": walk,
        "flicker_rms": np.sqrt(flicker) * sd,
        "random_walk_per_sqrt_s": np.sqrt(walk / WALK_S) * sd,
        "heavy_tails": len(residual) * max(excess, 0.0) ** 2 / 24.0 - search.likelihood.price,
    }


def _effect(verdict: ChannelVerdict, claim: Claim) -> Content:
    finding = claim.finding
    alone = _left(verdict, _alone(verdict, finding.candidate))
    before, after = _alone(verdict).train_rms, alone["train_rms"]
    return {
        "name": finding.name,
        "parameters": _parameters(claim.parts),
        "sigma": [
            part.nonlinear
            | {"coefficients": rows if len(rows := part.coefficients.tolist()) > 1 else rows[0]}
            for part in claim.sigmas
        ],
        "carried_over": any(part.carries_over for part in claim.parts),
        "evidence": {
            "proven_by": "test" if finding.by_test else "training",
            "gain_bic": finding.gain,
            "test_gain": None,  # always, as the format has it
            "pooled_gain_bic": finding.gain_over_axes,
            "rms_explained": np.sqrt(max(before**2 - after**2, 0.0)),
            "explained_share_alone": explained_share(before, after, verdict.channel.floor.sd),
            "rivals_gain_bic": {name: value for name, value in finding.family_gains.items() if value > 0},
        },
        "test_rms_alone": alone["test_rms"],
    }


def _parameters(parts: Sequence[FittedPart]) -> Content:
    """Return the parameters of one part as they are, of several as lists."""
    each = []
    for part in parts:
        parameters = part.effect.model_dump(exclude={"kind", "coefficients"})
        rows, runs = part.coefficients.tolist(), [*part.separate_runs]
        parameters |= {"coefficients": rows, "runs": runs} if runs else {"coefficients": rows[0]}
        parameters |= {"start": part.start.tolist()} if len(part.start) else {}
        each.append(parameters)
    return each[0] if len(each) == 1 else {key: [one.get(key) for one in each] for key in each[0]}


def _alone(verdict: ChannelVerdict, *candidates: Candidate) -> Fit:
    return fit(verdict.channel, [*verdict.search.present, *candidates])


def _left(verdict: ChannelVerdict, fitted: Fit) -> dict[str, float]:
    return {"train_rms": fitted.train_rms, "test_rms": score_test(verdict.channel, fitted).rms}


def _runs_left(verdict: ChannelVerdict) -> Iterator[Content]:
    channel = verdict.channel
    training = [channel.training.split(fitted.residual) for fitted in (verdict.before, verdict.after)]
    test = [
        [of_run[counting] for of_run, counting in zip(score.predicted_residual, score.counts, strict=True)]
        for score in (verdict.test_before, verdict.prediction)
    ]
    for is_test, runs, residuals in ((False, channel.training.runs, training), (True, channel.test, test)):
        for run, first, last in zip(runs, *residuals, strict=True):
            yield {
                "name": run.in_slots.name,
                "test": is_test,
                "blocks": len(last),
                "before": root_mean_square(first),
                "after": root_mean_square(last),
                "mean": last.mean() if len(last) else np.nan,
            }


def _questions(verdict: ChannelVerdict) -> list[list[Content]]:
    """Return what is open, each question as its answers: an effect that may be the one, or `NOTHING`, whether
    it carries over, and the model that has it, fitted to the training, with effects as in a model file."""
    claimed, opened = [finding.candidate for finding in verdict.findings], []

    def answer(beside: Sequence[Candidate], added: Candidate | None) -> Content:
        model = fit(verdict.channel, [*beside, added] if added else beside)
        return {
            "name": added.family if added else NOTHING,
            "carries": not added or added.shared,
            "declared": model.declared.tolist(),
            "effects": [part.effect.model_dump() for part in model.parts if part.carries_over],
        }

    for finding in verdict.findings:
        if finding.alternatives:
            beside = [other for other in claimed if other is not finding.candidate]
            possible = (finding.candidate, *finding.alternatives.values())
            opened.append([answer(beside, candidate) for candidate in possible])
    if verdict.unexplained:
        ranked = sorted(verdict.search.tables[-1].values(), key=lambda scored: -scored.gain)
        tried = [scored.candidate for scored in ranked if scored.linear_gain > 0.0]
        # A chamber, or poses, can make these show themselves in another run.
        lasting = [one for one in tried if one.scope in ("shared", "either") and one not in claimed]
        further = [one for one in lasting if {*one.parts[0].effect.inputs} <= {ACCEL_DRIVER}][:2]
        opened.append([answer(claimed, candidate) for candidate in (None, *further)])
    return opened


class NextStep(NamedTuple):
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
    step = next(_steps(diagnosis, folder or Path()))
    return step if folder else step._replace(command="")


def _steps(diagnosis: Diagnosis, folder: Path) -> Iterator[NextStep]:
    """Yield what there is to do, the most urgent first."""
    verdicts, has_test = diagnosis.verdicts, bool(diagnosis.test) and not diagnosis.held_out
    out, plan, model = (shlex.quote(str(path)) for path in (folder, folder / "next", folder / "model.yaml"))

    def which(holds: Callable[[ChannelVerdict], bool]) -> str:
        return ", ".join(verdict.name for verdict in verdicts if holds(verdict))

    unproven = {one.name for one in verdicts if one.channel.test and one.row.state == "not proven"}
    if names := which(lambda one: one.faulty or one.hidden or (one.channel.coarse and one.name in unproven)):
        yield NextStep(
            f"Record {names} again with a range and digits that its noise and bias fit in.",
            "Its values hide what matters: one comes far too often, or their steps are coarse.",
        )
    if ONE_WAY in diagnosis.caveats:
        yield NextStep(
            "Record a session in which the unit warms and cools, and train on that.",
            "Until then what lag, hysteresis or warm-up do is part of the curve.",
        )
    if not has_test or any(verdict.by_test for verdict in verdicts):
        yield NextStep(
            "Record another session from power-on and test on that.",
            "The test has chosen: train on it, too." if has_test else "Without a test nothing is proven.",
            f"imumon diagnose {diagnosis.options} {'--train TEST ' * has_test}--test NEW --out {out}",
        )
    if names := which(lambda verdict: verdict.shifted):
        what = (
            'Give --declared "polynomial N + offset" in place of --model'
            if diagnosis.model
            else 'Add " + offset" to --declared'
        )
        yield NextStep(
            f"{what} for {names}, and diagnose again.",
            "What is left of the test is a constant, as of another turn-on bias; training has no such rest.",
        )
    if names := which(lambda verdict: verdict.unexplained and not verdict.shifted):
        yield NextStep(
            f"Record {names} beside what else may drive it (supply, load, pressure, another thermometer),"
            f" {ISOTHERMAL}",
            "What is left jumps or comes in bursts, as no noise does, or it is slow noise of the unit.",
        )
    sets = [one.finding.names for verdict in verdicts for one in verdict.claims if one.finding.alternatives]
    for first, second, *_ in sets:
        yield NextStep(
            f"Record {separated_by(first, second)}.",
            f"{first} and {second} fit these recordings alike, and predict others differently.",
            f"imumon plan {out} --out {plan}",
        )
    if useful := [verdict for verdict in with_model(diagnosis) if verdict.claims and verdict.predicts]:
        least = min(verdict.test_after.rms / verdict.test_before.rms for verdict in useful)
        yield NextStep(
            f"Use the model with what is named of {', '.join(verdict.name for verdict in useful)}.",
            f"Errors in the test fall by up to {1.0 - least:.0%}.",
            f"imumon monitor PORT --device NAME --model {model}",
        )
    if names := which(lambda verdict: verdict.row.state == "not proven"):
        yield NextStep(
            f"Record {names} {ISOTHERMAL}", "What is left is little, noise or an effect too small to prove."
        )
    yield NextStep("Nothing has to be added.", "The declared model is enough on these recordings.")
