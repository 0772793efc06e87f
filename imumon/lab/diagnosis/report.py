"""report.json: what was found, in numbers, for programs."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any, Final

import numpy as np

from imumon.blocks import FloatArray
from imumon.effects.library import separated_by
from imumon.files import plain, write_text
from imumon.lab.diagnosis.blocks import RunBlocks
from imumon.lab.diagnosis.conclusion import conclusion, next_step
from imumon.lab.diagnosis.diagnose import Diagnosis
from imumon.lab.diagnosis.fit import FittedPart
from imumon.lab.diagnosis.verdict import ChannelVerdict, Claim
from imumon.version import __version__

FORMAT: Final = "imumon-diagnosis/1"


def report(diagnosis: Diagnosis, folder: Path | None = None) -> dict[str, Any]:
    """Return the report as it is written into a folder; absent numbers are None."""
    given, length, survey = diagnosis.model, diagnosis.length, diagnosis.survey
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
        if length is None
        else {name: np.asarray(value).tolist() for name, value in asdict(length).items()},
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
    floor, test = verdict.channel.floor, verdict.test_after
    return {
        "verdict": verdict.row.state,
        "unit": verdict.channel.unit,
        "noise_floor_rms": floor.sd,
        "noise_floor_from": floor.source,
        "slow_noise": asdict(verdict.slow),
        "before": {"train_rms": verdict.before.train_rms, "test_rms": verdict.test_before.rms},
        "after": {
            "train_rms": verdict.after.train_rms,
            "test_rms": test.rms,
            "test_rms_tracked": test.estimated_rms,
        },
        "coverage": test.coverage,
        "scored": test.scored,
        "explained_share": verdict.explained,
        "curve": _curve(verdict),
        "effects": [_effect(claim) for claim in verdict.claims],
        "ranking": verdict.ranking,
        "runs": verdict.runs,
        "indistinguishable": [claim.finding.alike for claim in verdict.claims if claim.finding.alike],
        "to_separate": [
            {"effects": [claim.finding.alike[0], other], "by": separated_by(claim.finding.alike[0], other)}
            for claim in verdict.claims
            for other in claim.finding.alike[1:]
        ],
        "questions": verdict.questions,
        "turns": verdict.turns,
        "fitted_anew": verdict.refit,
        "left_out": verdict.left_out,
        "in_model_file": verdict.predicts,
        "faults": [fault.text for fault in verdict.channel.faults],
        "unexplained": verdict.unexplained,
        "formula": None,
        "remark": verdict.remark,
        "summary": verdict.summary,
    }


def _curve(verdict: ChannelVerdict) -> dict[str, Any]:
    declared = verdict.channel.declared
    return {
        "coefficients": verdict.after.declared.tolist(),
        "sigma": np.sqrt(np.diag(verdict.declared_covariance)).tolist(),
        "middle_degc": declared.middle_degc,
        "half_span_degc": declared.half_span_degc,
    }


def _effect(claim: Claim) -> dict[str, Any]:
    finding = claim.finding
    return {
        "name": finding.name,
        "parameters": _parameters(claim.parts),
        "sigma": [{**one.searched, "coefficients": _rows(one.coefficients)} for one in claim.sigmas],
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


def _rows(coefficients: FloatArray) -> Any:
    """Return rows (runs, k), or the only one."""
    return (coefficients[0] if len(coefficients) == 1 else coefficients).tolist()


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
