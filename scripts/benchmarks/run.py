"""Command line of scripts/benchmark: sections by name, as tables, JSON or Markdown."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict
from importlib import import_module
from pathlib import Path

from rich.console import Console
from rich.table import Table as RichTable

from benchmarks.measure import BUSY, Bar, Machine, Table, machine

SECTIONS = {
    "compile": "benchmarks.compilation",
    "start": "benchmarks.start",
    "decoders": "benchmarks.decoders",
    "growth": "benchmarks.growth",
    "devices": "benchmarks.tagged",
    "clocks": "benchmarks.clocks",
    "pipeline": "benchmarks.path",
    "replay": "benchmarks.replay",
    "live": "benchmarks.live",
    "temperature": "benchmarks.stages:temperature",
    "rest": "benchmarks.stages:rest",
    "zupt": "benchmarks.stages:zupt",
    "random_error": "benchmarks.stages:random_error",
    "allan": "benchmarks.allan",
    "batch": "benchmarks.batch",
    "alignment": "benchmarks.stages:alignment",
}
RACE = {"race": "benchmarks.race"}
"""It wants packages of others, which `scripts/environment race` installs."""
BY_NAME = {"archive": "benchmarks.archive", **RACE}
"""Run by their names only: these take long, or want more."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the sections; return 1 when a bar that does not depend on the machine is missed."""
    parser = argparse.ArgumentParser(prog="scripts/benchmark", description="Speed, as ratios in one run.")
    parser.add_argument(
        "sections",
        nargs="*",
        metavar="SECTION",
        help=f"of {', '.join(SECTIONS | BY_NAME)}; default all but {' and '.join(BY_NAME)}",
    )
    parser.add_argument("--race", action="store_true", help="the section race: against other programs")
    parser.add_argument("--json", action="store_true", help="print figures as JSON")
    parser.add_argument(
        "--markdown", type=Path, metavar="FILE", help="write the tables to a Markdown file as well"
    )
    options = parser.parse_args(arguments)
    every, wanted = SECTIONS | BY_NAME, [*options.sections, *RACE] if options.race else options.sections
    if unknown := set(wanted) - every.keys():
        parser.error(f"no section {', '.join(sorted(unknown))}; there are: {', '.join(every)}")
    host, tables, bars = machine(), [], []
    for name in wanted or SECTIONS:
        module, _, function = every[name].partition(":")
        new_tables, new_bars = getattr(import_module(module), function or "run")()
        tables += new_tables
        bars += new_bars
        if not options.json:
            for table in new_tables:
                show(table)
    if bars:
        tables.append(bar_table(bars))
    if options.json:
        print(json.dumps({"machine": host.facts(), "tables": [asdict(table) for table in tables]}, indent=1))
    else:
        if bars:
            show(tables[-1])
        print(facts(host))
    if options.markdown:
        options.markdown.write_text(as_markdown(host, wanted, tables), encoding="utf-8")
    return int(any(bar.required and not bar.passed for bar in bars))


def bar_table(bars: Sequence[Bar]) -> Table:
    """Return the bars, what was measured, and whether it is enough."""
    table = Table("Bars", ["bar", "demanded", "measured", "ratio", "verdict"])
    for bar in bars:
        ratio = f"{bar.measured / bar.demanded:.2f}" if bar.demanded else "-"
        limit = f"{'≤' if bar.at_most else '≥'} {bar.demanded:g}"
        table.rows.append([bar.name, limit, f"{bar.measured:.4g}", ratio, "PASS" if bar.passed else "FAIL"])
    return table


def show(table: Table) -> None:
    """Print a table."""
    view = RichTable(title=table.title, title_justify="left")
    for number, heading in enumerate(table.headings):
        view.add_column(heading, justify="left" if number == 0 else "right")
    for row in table.rows:
        view.add_row(*row)
    console = Console()
    console.print(view)
    for note in table.notes:
        console.print(note)
    console.print()


def facts(host: Machine) -> str:
    """Return what the figures were measured on, with a warning when others used the machine."""
    text = (
        f"{host.cpu}, {host.cores} cores, one used; Python {host.python}, NumPy {host.numpy}, "
        f"numba {host.numba}; load before the run {host.load_before}"
    )
    if host.busy:
        text += f".\nWarning: the load was above {BUSY}: others used the machine, so the figures are low"
    return text + "."


def as_markdown(host: Machine, sections: Sequence[str], tables: Sequence[Table]) -> str:
    """Return the tables of these sections as a Markdown file."""
    lines = [
        "# Measured figures",
        "",
        f"Written by `{' '.join(['scripts/benchmark', *sections])} --markdown FILE`; not edited by hand.",
        "",
    ]
    lines += [facts(host), ""]
    for table in tables:
        lines += [f"## {table.title}", "", "| " + " | ".join(table.headings) + " |"]
        lines += ["|" + "|".join([" --- ", *[" ---: "] * (len(table.headings) - 1)]) + "|"]
        lines += ["| " + " | ".join(row) + " |" for row in table.rows]
        lines += ["", *(line for note in table.notes for line in (note, ""))]
    return "\n".join(lines).rstrip() + "\n"


if __name__ == "__main__":
    sys.exit(main())
