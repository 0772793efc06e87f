"""Two models on the same recording: what each leaves of it, on one page."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib.axes import Axes

from imumon.errors import ImumonError, Reason
from imumon.files import write_text
from imumon.lab.diagnosis.better import residual
from imumon.lab.diagnosis.blocks import BLOCK_S, RunBlocks
from imumon.lab.diagnosis.figures import AFTER, BEFORE, HOUR_S, shown, svg
from imumon.lab.diagnosis.known import temperature_of
from imumon.lab.diagnosis.page import environment
from imumon.lab.diagnosis.runs import Run, unit_of
from imumon.models.model import BiasModel

TEMPLATE = "compared.html.j2"


@dataclass(frozen=True, slots=True, eq=False)
class Compared:
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
        if names:
            first, second = (residual(run, model, names) for model in models)
            if len(first) > 1:
                found += [
                    Compared(run.name, name, temperature_of(name, models[0], [run]), (first, second))
                    for name in names
                ]
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
    write_text(path, environment().get_template(TEMPLATE).render(**content))


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
