"""report.html: the diagnosis for people, one file that needs no network."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

from imumon.diagnosis.conclusion import in_short, keep_in_mind, state
from imumon.diagnosis.engine import Diagnosis, Progress
from imumon.diagnosis.figures import figures, shown
from imumon.diagnosis.looking import RunLeft, most_different
from imumon.diagnosis.report import report
from imumon.diagnosis.verdict import ChannelVerdict, Claim
from imumon.files import write_text
from imumon.harmless import for_html

TEMPLATE = "report.html.j2"


def write_page(diagnosis: Diagnosis, path: Path, progress: Progress | None = None) -> None:
    """Write report.html; raises OSError when that fails."""
    content = report(diagnosis, path.parent)
    channels = []
    for verdict in diagnosis.verdicts:
        if progress is not None:
            progress(f"drawing {verdict.name}")
        channels.append(_channel(diagnosis, verdict, content["channels"][verdict.name]))
    rows = [_row(verdict) for verdict in diagnosis.verdicts]
    text = (
        environment()
        .get_template(TEMPLATE)
        .render(report=content, rows=rows, channels=channels, caveats=keep_in_mind(diagnosis))
    )
    write_text(path, text)


def environment(package: str = "imumon.diagnosis") -> Environment:
    """Return what fills in the pages of a package: whatever comes from outside is text, not markup."""
    return Environment(
        loader=PackageLoader(package, "."),
        autoescape=select_autoescape(default=True, default_for_string=True),
        undefined=StrictUndefined,
        finalize=for_html,
    )


def _row(verdict: ChannelVerdict) -> dict[str, Any]:
    scale, unit = shown(verdict.channel.unit)
    before, after = verdict.test_before, verdict.test_after
    left, estimated = np.nan, False
    if after is not None:
        left = after.left if verdict.claims else after.rms
        estimated = bool(left < after.rms)
    colours = {"named": "found", "nothing missing": "ok"}
    return {
        "name": verdict.name,
        "state": colours.get(state(verdict), "open"),
        "verdict": in_short(verdict),
        "beside": _beside(verdict, scale, unit),
        "before": _number(np.nan if before is None else before.rms * scale),
        "after": _number(left * scale),
        "estimated": estimated,
        "floor": _number(verdict.channel.floor.sd * scale),
        "covered": "" if after is None else f"{after.coverage:.0%}",
        "train_before": _number(verdict.before.train_rms * scale),
        "train_after": _number(verdict.after.train_rms * scale),
        "unit": unit,
    }


def _beside(verdict: ChannelVerdict, scale: float, unit: str) -> list[str]:
    """Return what stands small below a verdict: what comes nearest to an explanation."""
    if state(verdict) not in ("unexplained", "not proven"):
        return []
    nearest = [
        f"{one.name} ({_number(one.test_rms * scale)} {unit} in the test)" for one in verdict.ranking[:2]
    ]
    if verdict.test_before is None:
        nearest = [one.name for one in verdict.ranking[:2]]
    return [f"nearest, each alone: {', '.join(nearest)}"] if nearest else []


def _number(value: float) -> str:
    return "" if not np.isfinite(value) else f"{value:.3g}"


def _channel(diagnosis: Diagnosis, verdict: ChannelVerdict, content: dict[str, Any]) -> dict[str, Any]:
    scale, unit = shown(verdict.channel.unit)
    return {
        "name": verdict.name,
        "summary": verdict.summary,
        "effects": [
            _effect(effect, claim, scale, unit)
            for effect, claim in zip(content["effects"], verdict.claims, strict=True)
        ],
        "ranking": [
            [one.name, _number(one.gain), _number(one.train_rms * scale), _number(one.test_rms * scale)]
            for one in verdict.ranking
        ],
        "runs": [_run(one, scale, most=one is most_different(verdict.runs)) for one in verdict.runs],
        "curve": [
            [f"{at:.1f} °C", _number(value * scale), _number(sd * scale)] for at, value, sd in verdict.curve()
        ],
        "turns": [
            [step.done, _number(step.train_rms * scale), _number(step.test_rms * scale), _number(step.gain)]
            for step in verdict.turns
        ],
        "unit": unit,
        "left_out": [
            f"{item['name']} was found in training and left out: with it the test has"
            f" {_number(item['test_rms_with'] * scale)} {unit}, without it"
            f" {_number(item['test_rms_without'] * scale)} {unit}"
            if np.isfinite(item["test_rms_with"])
            else f"{item['name']} was found in training and left out: the test has nothing that can be scored"
            for item in verdict.left_out
        ],
        "figures": list(figures(diagnosis, verdict).items()),
    }


def _effect(effect: dict[str, Any], claim: Claim, scale: float, unit: str) -> dict[str, Any]:
    evidence = effect["evidence"]
    return {
        "name": effect["name"],
        "parameters": _parameters(effect["parameters"], claim, scale, unit),
        "gain": f"{evidence['gain_bic']:.0f}",
        "pooled": f"{evidence['pooled_gain_bic']:.0f}",
        "test_gain": "" if evidence["test_gain"] is None else f"{evidence['test_gain']:.0f}",
        "share": f"{evidence['explained_share_alone']:.0%}",
    }


def _run(one: RunLeft, scale: float, *, most: bool) -> dict[str, Any]:
    left = [_number(value * scale) for value in (one.before, one.after, one.mean)]
    return {"name": f"{one.name}{', test' if one.test else ''}", "most": most, "numbers": [one.blocks, *left]}


def _parameters(found: dict[str, Any], claim: Claim, scale: float, unit: str) -> str:
    """Return the parameters of an effect, searched or chosen, and its coefficients, with their sigma."""
    fitted = ("coefficients", "start", "runs", "amplitude")
    hidden = (*fitted, "middle", "half_span", "smoothing_s", "slack", "start_sd", "driver", "drivers")
    spread: dict[str, list[float]] = {}
    for part in claim.sigmas:
        for name, sd in part.searched.items():
            spread.setdefault(name, []).append(sd)
    texts = [
        f"{key} {_text(value)}" + (f" ± {_text(spread[key])}" if key in spread else "")
        for key, value in found.items()
        if key not in hidden
    ]
    sizes = [
        f"{value * scale:.3g} ± {sd * scale:.2g}"
        for part, sigma in zip(claim.parts, claim.sigmas, strict=True)
        for value, sd in zip(part.own.ravel().tolist(), sigma.coefficients.ravel().tolist(), strict=True)
    ]
    return ", ".join([*texts, f"coefficients {' / '.join(sizes)} {unit}".strip()])


def _text(value: Any) -> str:
    if isinstance(value, list):
        return " / ".join(map(_text, value))
    return f"{value:.3g}" if isinstance(value, float) else str(value)
