"""The pages for people, each one file that needs no network: report.html, and two models compared."""

import io
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import matplotlib as mpl
import numpy as np
from jinja2 import Environment, PackageLoader, StrictUndefined
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from imumon.blocks import FloatArray
from imumon.errors import bad_data
from imumon.files import write_text
from imumon.geodesy import DEG_PER_H, MICRO_G
from imumon.harmless import for_html, for_plot
from imumon.models.model import BiasModel

from .blocks import RunInBlocks
from .diagnose import Diagnosis
from .prepare import residual_blocks, temperature_of
from .report import report
from .runs import Run, unit_of
from .search import Progress
from .verdict import ChannelVerdict

HOUR_S = 3600.0
# Factor to the unit that a person reads, and that unit; others are read as they are.
SHOWN_AS = {"rad/s": (1.0 / DEG_PER_H, "°/h"), "m/s^2": (1.0 / MICRO_G, "µg")}
COLOURS = ("#1f4e79", "#c0504d", "#4f7f3f", "#8064a2", "#d08a2e", "#4bacc6")
AFTER, BEFORE = COLOURS[:2]
SIZE, WIDE = (5.2, 3.0), (9.6, 3.2)
OVER_TIME, OVER_DEGC = "time since power-on, h", "temperature, °C"


def environment(package: str = "imumon.lab.diagnosis") -> Environment:
    """Return what fills in the pages of a package: whatever comes from outside is text, not markup."""
    made = Environment(
        loader=PackageLoader(package, "."), autoescape=True, undefined=StrictUndefined, finalize=for_html
    )
    made.filters["number"] = _number
    made.globals.update(curve=_curve, shown=shown, unit_of=unit_of)
    return made


def shown(unit: str) -> tuple[float, str]:
    """Return the factor to the unit that a person reads, and that unit."""
    return SHOWN_AS.get(unit, (1.0, unit))


def svg(draw: Callable[[Axes], None], size: tuple[float, float] = SIZE) -> str:
    """Return what is drawn, with its legend, as SVG text."""
    settings: Any = {"svg.fonttype": "path", "svg.hashsalt": "imumon", "font.size": 8}
    with mpl.rc_context(settings):
        figure = Figure(figsize=size, layout="constrained")
        axes, text = figure.add_subplot(), io.StringIO()
        draw(axes)
        axes.legend(fontsize=6)
        figure.savefig(text, format="svg", metadata={"Date": None})
    content = text.getvalue()
    return content[content.index("<svg") :]


def write_page(diagnosis: Diagnosis, path: Path, progress: Progress = lambda _: None) -> None:
    """Write report.html; raises OSError when that fails."""
    drawn, verdicts = {}, diagnosis.verdicts
    for verdict in verdicts:
        progress(f"drawing {verdict.name}")
        drawn[verdict.name] = _figures(diagnosis, verdict)
    first = max(verdicts, key=_weight)
    picture = svg(lambda axes: _draw_errors(axes, diagnosis, first), WIDE)
    page, whole = environment().get_template("report.html.j2"), report(diagnosis, path.parent)
    write_text(path, page.render(report=whole, picture=picture, first=first, verdicts=verdicts, drawn=drawn))


def error_text(verdict: ChannelVerdict) -> str:
    """Return the error of the test, before and after where something is claimed; empty without a test."""
    (factor, unit), before = shown(unit_of(verdict.name)), verdict.test_before.rms
    becomes = f" → {_number(verdict.test_rms, factor)}" if verdict.claims else ""
    return f"{_number(before, factor)}{becomes} {unit}" if np.isfinite(before) else ""


def _curve(verdict: ChannelVerdict) -> list[tuple[float, float, float]]:
    """Return temperature, bias and its sigma at both ends and the middle of what training covered."""
    scale = verdict.channel.scale
    at = scale.middle + scale.half_span * np.array([-1.0, 0.0, 1.0])
    columns = verdict.channel.powers(at, len(verdict.after.declared))
    spread = np.sqrt(np.einsum("ij,jk,ik->i", columns, verdict.declared_covariance, columns))
    return list(zip(at, columns @ verdict.after.declared, spread, strict=True))


def _weight(verdict: ChannelVerdict) -> tuple[bool, float]:
    """Return what puts a channel on top of the page: that something is named, and the floors of its error."""
    error, floor = verdict.test_before.rms, verdict.channel.floor.sd
    error = error if np.isfinite(error) else verdict.before.train_rms
    return verdict.claimed, error / floor if floor > 0 else 0.0


def _number(value: float | None, scale: float = 1.0, digits: int = 3) -> str:
    if value is None or not np.isfinite(value):
        return ""
    value *= scale
    return f"{value:.0f}" if abs(value) >= 1000.0 else f"{value:.{digits}g}"


def _figures(diagnosis: Diagnosis, verdict: ChannelVerdict) -> dict[str, str]:
    runs = diagnosis.train
    scale, unit = shown(unit_of(verdict.name))
    split = verdict.channel.training.split
    before, after = (split(model.residual * scale) for model in (verdict.before, verdict.after))

    def draw(axes: Axes, over: Sequence[FloatArray], label: str) -> None:
        for at, run in enumerate(runs):
            colour = COLOURS[at % len(COLOURS)]
            axes.plot(over[at], before[at], ".", ms=3, color=colour, label=for_plot(run.in_slots.name))
            if verdict.claims:
                axes.plot(over[at], before[at] - after[at], "-", lw=1, color=colour)
        axes.set(xlabel=label, ylabel=f"left of {verdict.name}, {unit}")

    hours = [run.time_s / HOUR_S for run in runs]
    degc = [run.temperature[verdict.channel.training.temperature_name] for run in runs]
    return {
        "Training over time: what the declared model leaves (dots), and the effects (line)": svg(
            lambda axes: draw(axes, hours, OVER_TIME)
        ),
        "The same over temperature: a loop here is no curve": svg(lambda axes: draw(axes, degc, OVER_DEGC)),
    }


def _draw_errors(axes: Axes, diagnosis: Diagnosis, verdict: ChannelVerdict) -> None:
    scale, unit = shown(unit_of(verdict.name))
    if diagnosis.test:
        what, runs, score = "test", diagnosis.test, verdict.test_after
        before, counts = verdict.test_before.predicted_residual, np.concatenate(score.counts)
        is_estimated = score.estimated_rms < verdict.prediction.rms
        after = score.estimated_residual if is_estimated else verdict.prediction.predicted_residual
    else:
        what, runs = "training", diagnosis.train
        before, after = [verdict.before.residual], [verdict.after.residual]
        counts = np.ones(len(after[0]), bool)
    ends = np.cumsum([0.0, *(run.time_s[-1] for run in runs)])
    time = np.concatenate([run.time_s + end for run, end in zip(runs, ends[:-1], strict=True)]) / HOUR_S
    axes.plot(time, np.concatenate(before) * scale, ".", ms=4, color=BEFORE, label="before")
    if verdict.claims:
        axes.plot(time, np.concatenate(after) * scale, ".", ms=4, color=AFTER, label="after")
    if not counts.all():
        axes.plot(time[~counts], np.zeros_like(time[~counts]), "k|", ms=4, label="not scored")
    floor = verdict.channel.floor.sd * scale
    axes.axhspan(-floor, floor, color="0.85", zorder=0, label="white noise of a mean")
    axes.set(xlabel="time, h", ylabel=f"{what} error of {verdict.name}, {unit}")


class Compared(NamedTuple):
    """Block means of what each of two models leaves of a channel, and the temperature of its curve."""

    run: str
    channel: str
    temperatures: list[str]
    residuals: list[RunInBlocks]

    @property
    def rms(self) -> list[float]:
        """Of what is left, less its mean: no model knows the turn-on offset, gravity or the earth rate."""
        return [blocks.mean[self.channel].std() for blocks in self.residuals]


def compare(runs: Sequence[Run], models: tuple[BiasModel, BiasModel]) -> list[Compared]:
    """Return what two models leave of every channel that both have.

    Raises BAD_DATA when there is none, or the unit was never at rest for 30 s.
    """
    compared = []
    for run in runs:
        names = [name for name in models[0].channels if name in models[1].channels and name in run.mean]
        residuals = [residual_blocks(run, model, names) for model in models] if names else []
        if residuals and len(residuals[0]) > 1:
            for name in names:
                temperatures = [temperature_of(name, model, [run]) for model in models]
                compared.append(Compared(run.name, name, temperatures, residuals))
    if not compared:
        raise bad_data(
            "there is nothing to compare: no channel of both models, or no 30 s at rest",
            "give a session at rest of the unit that the models are of",
        )
    return compared


def write_comparison(compared: Sequence[Compared], names: tuple[str, str], session: str, path: Path) -> None:
    """Write the page; raises OSError when that fails."""
    page, block_s = environment().get_template("compared.html.j2"), round(compared[0].residuals[0].block_s)
    rows = [(each, [_drawn(each, names, over) for over in (OVER_TIME, OVER_DEGC)]) for each in compared]
    write_text(path, page.render(rows=rows, names=names, session=session, block_s=block_s))


def _drawn(compared: Compared, names: tuple[str, str], over: str) -> str:
    def draw(axes: Axes) -> None:
        scale, unit = shown(unit_of(compared.channel))
        each = zip(compared.residuals, compared.temperatures, names, (BEFORE, AFTER), strict=True)
        for blocks, column, name, colour in each:
            x = blocks.time_s / HOUR_S if over == OVER_TIME else blocks.temperature[column]
            values = blocks.mean[compared.channel]
            axes.plot(x, (values - values.mean()) * scale, ".", ms=3, color=colour, label=name)
        axes.set(xlabel=over, ylabel=f"{compared.channel}, {unit}")

    return svg(draw)
