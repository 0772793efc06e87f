"""report.html: the diagnosis for people, one file that needs no network."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

from imumon.files import write_text
from imumon.harmless import for_html
from imumon.lab.diagnosis.conclusion import keep_in_mind
from imumon.lab.diagnosis.diagnose import Diagnosis
from imumon.lab.diagnosis.figures import errors_plot, figures, shown
from imumon.lab.diagnosis.report import report
from imumon.lab.diagnosis.search import Progress
from imumon.lab.diagnosis.verdict import ChannelVerdict, Claim

TEMPLATE = "report.html.j2"
CLASSES = {"named": "found", "nothing missing": "ok"}


def write_page(diagnosis: Diagnosis, path: Path, progress: Progress | None = None) -> None:
    """Write report.html; raises OSError when that fails."""
    channels = []
    for verdict in diagnosis.verdicts:
        if progress is not None:
            progress(f"drawing {verdict.name}")
        channels.append(_channel(diagnosis, verdict))
    first = max(diagnosis.verdicts, key=_weight)
    text = (
        environment()
        .get_template(TEMPLATE)
        .render(
            report=report(diagnosis, path.parent),
            picture=errors_plot(diagnosis, first),
            sure=how_sure(first),
            channels=channels,
            caveats=keep_in_mind(diagnosis),
        )
    )
    write_text(path, text)


def environment(package: str = "imumon.lab.diagnosis") -> Environment:
    """Return what fills in the pages of a package: whatever comes from outside is text, not markup."""
    return Environment(
        loader=PackageLoader(package, "."),
        autoescape=select_autoescape(default=True, default_for_string=True),
        undefined=StrictUndefined,
        finalize=for_html,
    )


def how_sure(verdict: ChannelVerdict) -> str:
    """Return in a sentence what supports a verdict: the error in the test, and the white noise beside it."""
    scale, unit = shown(verdict.channel.unit)
    before, after = _errors(verdict)
    floor = f"white noise alone would leave {_number(verdict.channel.floor.sd * scale)} {unit}"
    if not np.isfinite(before):
        return f"There is no test that can be scored, so nothing proves it: {floor}."
    name, was = verdict.name, f"{_number(before * scale)} {unit}"
    if not verdict.claims:
        return f"On recordings that the fit has not used, {name} errs by {was}; {floor}."
    return (
        f"On recordings that the fit has not used, the error of {name} goes from {was} to"
        f" {_number(after * scale)} {unit}; {floor}."
    )


def _errors(verdict: ChannelVerdict) -> tuple[float, float]:
    """Return the rms of the test before and after; NaN without one."""
    test = verdict.test_after
    return verdict.test_before.rms, test.left if verdict.claims else test.rms


def _weight(verdict: ChannelVerdict) -> tuple[bool, float]:
    """Return what puts a channel on top of the page: that something is named, and the floors of its error."""
    before = _errors(verdict)[0]
    error = before if np.isfinite(before) else verdict.before.train_rms
    return bool(verdict.claims), error / verdict.channel.floor.sd if verdict.channel.floor.sd > 0 else 0.0


def _number(value: float) -> str:
    if not np.isfinite(value):
        return ""
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"


def _channel(diagnosis: Diagnosis, verdict: ChannelVerdict) -> dict[str, Any]:
    scale, unit = shown(verdict.channel.unit)
    before, after = (_number(value * scale) for value in _errors(verdict))
    score = verdict.test_after
    return {
        "name": verdict.name,
        "unit": unit,
        "state": CLASSES.get(verdict.row.state, "open"),
        "verdict": verdict.in_short,
        "before": before,
        "after": after if verdict.claims else "",
        "estimated": _errors(verdict)[1] < score.rms,
        "floor": _number(verdict.channel.floor.sd * scale),
        "covered": f"{score.coverage:.0%}" if verdict.channel.test else "",
        "summary": verdict.summary,
        "effects": [_effect(claim, scale, unit) for claim in verdict.claims],
        "ranking": [
            [one["name"], *map(_number, (one["gain"], one["train_rms"] * scale, one["test_rms"] * scale))]
            for one in verdict.ranking
        ],
        "runs": [
            {
                "name": f"{one['name']}{', test' if one['test'] else ''}",
                "numbers": [
                    one["blocks"],
                    *(_number(one[key] * scale) for key in ("before", "after", "mean")),
                ],
            }
            for one in verdict.runs
        ],
        "curve": [
            [f"{at:.1f} °C", _number(value * scale), _number(sd * scale)] for at, value, sd in verdict.curve()
        ],
        "figures": list(figures(diagnosis, verdict).items()),
    }


def _effect(claim: Claim, scale: float, unit: str) -> list[str]:
    """Return name, parameters with their sigmas, gain in training, and share explained of an effect."""
    texts, sizes = [], []
    for part, sigma in zip(claim.parts, claim.sigmas, strict=True):
        texts += [
            f"{name} {getattr(part.effect, name):.3g} ± {sd:.2g}" for name, sd in sigma.searched.items()
        ]
        own, spread = part.own.ravel().tolist(), sigma.coefficients.ravel().tolist()
        sizes += [f"{x * scale:.3g} ± {sd * scale:.2g}" for x, sd in zip(own, spread, strict=True)]
    parameters = ", ".join([*texts, f"coefficients {' / '.join(sizes)} {unit}".strip()])
    return [claim.finding.name, parameters, f"{claim.finding.gain:.0f}", f"{claim.explained:.0%}"]
