"""The overview of a rack: a row for each unit, the same cells for a terminal, the viewer and the summary."""

from collections import Counter
from collections.abc import Sequence

from imumon.geodesy import DEG_PER_H
from imumon.harmless import for_markdown
from imumon.view.cards import DIGITS, measured

from .feed import Vitals

HEADINGS = (
    "unit", "state", "°C", "gyro bias x y z ± σ, °/h", "model", "Hz", "lost", "received", "CPU", "MB",
    "deaths",
)  # fmt: skip
SIDES = "<<" + ">" * (len(HEADINGS) - 2)
"""Words stand on the left, numbers on the right."""


Row = tuple[str, ...]
"""What stands below `HEADINGS`."""


def row_of(name: str, state: str, vitals: Vitals, deaths: int) -> Row:
    """Return the row of a unit; `deaths` is how often its process died."""
    return (
        name,
        state,
        measured(vitals.temperature_deg, decimals=DIGITS["°C"]),
        bias(vitals),
        vitals.lanes.get("model", "–"),
        f"{vitals.packets_per_s:.0f}",
        f"{vitals.packets_lost:,}",
        f"{vitals.bytes_received / 1e6:,.1f} MB",
        f"{vitals.cpu:.0%}",
        measured(vitals.memory_mb, decimals=0),
        str(deaths),
    )


def bias(vitals: Vitals) -> str:
    """Return the bias of the three axes with the largest of their sigmas, to its second digit."""
    if not vitals.bias:
        return "–"
    sd = max(vitals.bias_sd) / DEG_PER_H
    axes = [measured(value / DEG_PER_H, sd).partition(" ± ") for value in vitals.bias]
    return f"{' '.join(value for value, *_ in axes)} ± {axes[0][2]}"


def text_lines(rows: Sequence[Row]) -> list[str]:
    """Return the table as text, a line for each row, its headings first."""
    cells = [HEADINGS, *rows]
    widths = [max(map(len, column)) for column in zip(*cells, strict=True)]
    return [
        "  ".join(
            f"{cell:{side}{width}}" for cell, side, width in zip(line, SIDES, widths, strict=True)
        ).rstrip()
        for line in cells
    ]


def markdown(rows: Sequence[Row]) -> str:
    """Return the table as Markdown."""
    marks = [":--" if side == "<" else "--:" for side in SIDES]
    body = [[for_markdown(cell) for cell in row] for row in rows]
    return "\n".join(f"| {' | '.join(line)} |" for line in [HEADINGS, marks, *body])


def in_short(rows: Sequence[Row]) -> str:
    """Return how many units are in each state, in one line."""
    counts = Counter(row[HEADINGS.index("state")] for row in rows)
    return f"{len(rows)} units: " + ", ".join(f"{count} {state}" for state, count in counts.items())
