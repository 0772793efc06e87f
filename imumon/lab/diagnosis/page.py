"""The pages for people, each one file that needs no network: report.html, and two models compared."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined, select_autoescape
from matplotlib.axes import Axes

from imumon.errors import ImumonError, Reason
from imumon.files import write_text
from imumon.harmless import for_html
from imumon.lab.diagnosis.better import residual
from imumon.lab.diagnosis.blocks import BLOCK_S, RunBlocks
from imumon.lab.diagnosis.channel import temperature_of
from imumon.lab.diagnosis.diagnose import Diagnosis
from imumon.lab.diagnosis.figures import AFTER, BEFORE, HOUR_S, errors_plot, figures, shown, svg
from imumon.lab.diagnosis.report import report
from imumon.lab.diagnosis.runs import Run, unit_of
from imumon.lab.diagnosis.search import Progress
from imumon.lab.diagnosis.verdict import ChannelVerdict
from imumon.models.model import BiasModel

CLASSES = {"named": "found", "nothing missing": "ok"}


def environment(package: str = "imumon.lab.diagnosis") -> Environment:
    """Return what fills in the pages of a package: whatever comes from outside is text, not markup."""
    return Environment(
        loader=PackageLoader(package, "."),
        autoescape=select_autoescape(default=True, default_for_string=True),
        undefined=StrictUndefined,
        finalize=for_html,
    )


def write_page(diagnosis: Diagnosis, path: Path, progress: Progress | None = None) -> None:
    """Write report.html; raises OSError when that fails."""
    content = report(diagnosis, path.parent)
    channels = []
    for verdict in diagnosis.verdicts:
        if progress is not None:
            progress(f"drawing {verdict.name}")
        scale, unit = shown(verdict.channel.unit)
        channels.append(
            {
                "verdict": verdict,
                "numbers": content["channels"][verdict.name],
                "scale": scale,
                "unit": unit,
                "class": CLASSES.get(verdict.row.state, "open"),
                "errors": _errors(verdict),
                "curve": _curve(verdict),
                "figures": figures(diagnosis, verdict),
            }
        )
    first = max(diagnosis.verdicts, key=_weight)
    pages = environment()
    pages.filters["number"] = _number
    text = pages.get_template("report.html.j2").render(
        report=content, picture=errors_plot(diagnosis, first), sure=_how_sure(first), channels=channels
    )
    write_text(path, text)


def _how_sure(verdict: ChannelVerdict) -> str:
    """Return in a sentence what supports a verdict: the error in the test, and the white noise beside it."""
    scale, unit = shown(verdict.channel.unit)
    before, after = (_number(value, scale) for value in _errors(verdict))
    floor = f"white noise alone would leave {_number(verdict.channel.floor.sd, scale)} {unit}"
    if not before:
        return f"There is no test that can be scored, so nothing proves it: {floor}."
    becomes = f"goes from {before} {unit} to {after}" if verdict.claims else f"is {before}"
    return f"On recordings that the fit has not used, the error of {verdict.name} {becomes} {unit}; {floor}."


def _errors(verdict: ChannelVerdict) -> tuple[float, float]:
    """Return the rms of the test before and after; NaN without one."""
    test = verdict.test_after
    return verdict.test_before.rms, test.left if verdict.claims else test.rms


def _curve(verdict: ChannelVerdict) -> list[tuple[float, float, float]]:
    """Return temperature, bias and its sigma at both ends and the middle of what training covered."""
    declared = verdict.channel.declared
    at = declared.middle_degc + declared.half_span_degc * np.array([-1.0, 0.0, 1.0])
    columns = declared.columns(at, len(verdict.after.declared))
    spread = np.sqrt(np.einsum("ij,jk,ik->i", columns, verdict.declared_covariance, columns))
    values = columns @ verdict.after.declared
    return list(zip(at.tolist(), values.tolist(), spread.tolist(), strict=True))


def _weight(verdict: ChannelVerdict) -> tuple[bool, float]:
    """Return what puts a channel on top of the page: that something is named, and the floors of its error."""
    error = float(np.nan_to_num(verdict.test_before.rms, nan=verdict.before.train_rms))
    return bool(verdict.claims), error / verdict.channel.floor.sd if verdict.channel.floor.sd > 0 else 0.0


def _number(value: float | None, scale: float = 1.0, digits: int = 3) -> str:
    if value is None or not np.isfinite(value):
        return ""
    value *= scale
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.{digits}g}"


# Two models on the same recording


class Compared(NamedTuple):
    """What two models leave of a channel in a run, as means of 30 s at rest."""

    run: str
    channel: str
    temperature: str
    """That the first model's curve is over."""
    left: tuple[RunBlocks, RunBlocks]
    """With the first and with the second model."""

    @property
    def rms(self) -> tuple[float, float]:
        """Of what is left, less its mean: no model knows the turn-on offset, gravity or the earth rate."""
        first, second = (float(blocks.mean[self.channel].std()) for blocks in self.left)
        return first, second


def compare(runs: Sequence[Run], models: tuple[BiasModel, BiasModel]) -> list[Compared]:
    """Return what two models leave of every channel that both have.

    Raises BAD_DATA when there is none, or the unit was never at rest for 30 s.
    """
    found = []
    for run in runs:
        names = [name for name in models[0].channels if name in models[1].channels and name in run.mean]
        left = [residual(run, model, names) for model in models] if names else []
        if left and len(left[0]) > 1:
            at = {name: temperature_of(name, models[0], [run]) for name in names}
            found += [Compared(run.name, name, at[name], (left[0], left[1])) for name in names]
    if not found:
        raise ImumonError(
            Reason.BAD_DATA,
            "there is nothing to compare: no channel of both models, or no 30 s at rest",
            "give a session at rest of the unit that the models are of",
        )
    return found


def write_comparison(compared: Sequence[Compared], names: tuple[str, str], session: str, path: Path) -> None:
    """Write the page; raises OSError when that fails."""
    rows = []
    for one in compared:
        scale, unit = shown(unit_of(one.channel))
        numbers = [f"{value * scale:.3g}" for value in one.rms]
        drawn = [_drawn(one, names, over) for over in ("time since power-on, h", "temperature, °C")]
        rows.append(
            {"run": one.run, "channel": one.channel, "numbers": numbers, "unit": unit, "drawn": drawn}
        )
    content = {"rows": rows, "names": names, "session": session, "block_s": BLOCK_S}
    write_text(path, environment().get_template("compared.html.j2").render(**content))


def _drawn(one: Compared, names: tuple[str, str], over: str) -> str:
    """Return what both models leave of a channel, over time or temperature, as SVG text."""

    def draw(axes: Axes) -> None:
        scale, unit = shown(unit_of(one.channel))
        for blocks, name, colour in zip(one.left, names, (BEFORE, AFTER), strict=True):
            x = blocks.time_s / HOUR_S if over.startswith("time") else blocks.temperature[one.temperature]
            values = blocks.mean[one.channel]
            axes.plot(x, (values - values.mean()) * scale, ".", ms=3, color=colour, label=name)
        axes.set(xlabel=over, ylabel=f"{one.channel}, {unit}")
        axes.legend(fontsize=6)

    return svg(draw)
