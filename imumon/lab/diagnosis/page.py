"""report.html: the diagnosis for people, one file that needs no network."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape

from imumon.files import write_text
from imumon.harmless import for_html
from imumon.lab.diagnosis.conclusion import keep_in_mind
from imumon.lab.diagnosis.diagnose import Diagnosis
from imumon.lab.diagnosis.figures import errors_plot, figures, shown
from imumon.lab.diagnosis.report import report
from imumon.lab.diagnosis.search import Progress
from imumon.lab.diagnosis.verdict import ChannelVerdict

TEMPLATE = "report.html.j2"
CLASSES = {"named": "found", "nothing missing": "ok"}


def write_page(diagnosis: Diagnosis, path: Path, progress: Progress | None = None) -> None:
    """Write report.html; raises OSError when that fails."""
    drawn = {}
    for verdict in diagnosis.verdicts:
        if progress is not None:
            progress(f"drawing {verdict.name}")
        drawn[verdict.name] = figures(diagnosis, verdict)
    first = max(diagnosis.verdicts, key=_weight)
    pages = environment()
    pages.filters["number"] = _number
    text = pages.get_template(TEMPLATE).render(
        report=report(diagnosis, path.parent),
        picture=errors_plot(diagnosis, first),
        sure=how_sure(first),
        channels=[
            {
                "verdict": verdict,
                "scale": shown(verdict.channel.unit)[0],
                "unit": shown(verdict.channel.unit)[1],
                "class": CLASSES.get(verdict.row.state, "open"),
                "errors": _errors(verdict),
                "figures": drawn[verdict.name],
            }
            for verdict in diagnosis.verdicts
        ],
        caveats=keep_in_mind(diagnosis),
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


def _number(value: float, digits: int = 3) -> str:
    if not np.isfinite(value):
        return ""
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.{digits}g}"
