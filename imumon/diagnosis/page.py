"""report.html: the diagnosis for people, one file that needs no network."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

from imumon.diagnosis.engine import Diagnosis, Progress
from imumon.diagnosis.figures import figures, shown
from imumon.diagnosis.formula import Formula
from imumon.diagnosis.report import report
from imumon.diagnosis.verdict import ChannelVerdict
from imumon.harmless import for_html

TEMPLATE = "report.html.j2"


def write_page(diagnosis: Diagnosis, path: Path, progress: Progress | None = None) -> None:
    """Write report.html; raises OSError when that fails."""
    content = report(diagnosis)
    channels = []
    for verdict in diagnosis.verdicts:
        if progress is not None:
            progress(f"drawing {verdict.name}")
        channels.append(_channel(diagnosis, verdict, content["channels"][verdict.name]))
    rows = [_row(verdict) for verdict in diagnosis.verdicts]
    text = environment().get_template(TEMPLATE).render(report=content, rows=rows, channels=channels)
    path.write_text(text, encoding="utf-8")


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
    test = verdict.test_before, verdict.test_after
    numbers = [
        verdict.channel.floor.sd,
        verdict.before.train_rms,
        verdict.after.train_rms,
        np.nan if test[0] is None else test[0].rms,
        np.nan if test[1] is None else test[1].rms,
        np.nan if test[1] is None else test[1].tracked_rms,
    ]
    names = [" or ".join(claim.finding.alike) or claim.finding.name for claim in verdict.claims]
    state = "found" if names else "open" if verdict.unexplained else "ok"
    said = ", ".join(names) or ("unexplained" if verdict.unexplained else "nothing missing")
    if names and verdict.unexplained:
        said += "; remainder unexplained"
    return {
        "name": verdict.name,
        "state": state,
        "verdict": said,
        "numbers": [_number(value * scale) for value in numbers],
        "unit": unit,
    }


def _number(value: float) -> str:
    return "" if not np.isfinite(value) else f"{value:.3g}"


def _channel(diagnosis: Diagnosis, verdict: ChannelVerdict, content: dict[str, Any]) -> dict[str, Any]:
    scale, unit = shown(verdict.channel.unit)
    return {
        "name": verdict.name,
        "summary": verdict.summary,
        "effects": [
            {
                "name": effect["name"],
                "parameters": _parameters(effect["parameters"]),
                "gain": f"{effect['evidence']['gain_bic']:.0f}",
                "pooled": f"{effect['evidence']['pooled_gain_bic']:.0f}",
                "share": f"{effect['evidence']['explained_share_alone']:.0%}",
            }
            for effect in content["effects"]
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
        "formula": _formula(verdict.formula, scale),
        "figures": list(figures(diagnosis, verdict).items()),
    }


def _formula(found: Formula | None, scale: float) -> dict[str, Any] | None:
    """Return what describes the unexplained, as the page has it."""
    if found is None:
        return None
    return {
        "text": found.text(scale),
        "signals": [
            f"{name} less {each.middle:.4g}, over {each.half_span:.4g}" for name, each in found.scales.items()
        ],
        "tried": found.tried,
        "before": _number(found.test_before * scale),
        "after": _number(found.test_rms * scale),
    }


def _parameters(found: dict[str, Any]) -> str:
    fitted = ("coefficients", "start", "runs", "amplitude")
    hidden = (*fitted, "middle", "half_span", "smoothing_s", "slack", "start_sd", "driver", "drivers")
    return ", ".join(f"{key} {_text(value)}" for key, value in found.items() if key not in hidden)


def _text(value: Any) -> str:
    if isinstance(value, list):
        return "/".join(map(_text, value))
    return f"{value:.4g}" if isinstance(value, float) else str(value)
