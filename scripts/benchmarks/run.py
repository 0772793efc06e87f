"""Command line of scripts/benchmark: sections by name, as Markdown tables."""

import argparse
import gc
from collections.abc import Sequence
from importlib import import_module
from pathlib import Path

from study import Cells, Table

from benchmarks.measure import Bar, machine
from imumon.cli import NEW_OBJECTS

SECTIONS = {
    "start": "sessions",
    "chunks": "decoding",
    "devices": "decoding",
    "replay": "sessions",
    "live": "live",
    "zupt": "stages",
    "random_error": "stages",
    "allan": "stages",
    "batch": "batch",
}
"""The module of each section; its function has the name of the section."""
BY_NAME = {"race": "race"}
"""Run by its name only: it wants packages of others, which `scripts/environment race` installs."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the sections."""
    every = SECTIONS | BY_NAME
    parser = argparse.ArgumentParser(prog="scripts/benchmark", description="Speed, as ratios in one run.")
    parser.add_argument(
        "sections", nargs="*", metavar="SECTION", help=f"of {', '.join(every)}; default all but race"
    )
    parser.add_argument("--markdown", type=Path, metavar="FILE", help="write the tables to a file as well")
    options = parser.parse_args(arguments)
    if unknown := set(options.sections) - every.keys():
        parser.error(f"no section {', '.join(sorted(unknown))}; there are: {', '.join(every)}")
    gc.set_threshold(NEW_OBJECTS)  # as the command line sets it
    host, bars = machine(), list[Bar]()
    command = " ".join(["scripts/benchmark", *options.sections])
    texts = [f"# Measured figures\n\nWritten by `{command} --markdown FILE`; not edited by hand.\n\n{host}\n"]
    for name in options.sections or SECTIONS:
        tables, new = getattr(import_module(f"benchmarks.{every[name]}"), name)()
        bars += new
        for table in tables:
            texts.append(table.markdown())
            print(texts[-1], flush=True)
    if bars:
        texts.append(bar_table(bars).markdown())
        print(texts[-1])
    print(host)
    if options.markdown:
        options.markdown.write_text("\n".join(texts), encoding="utf-8")


def bar_table(bars: Sequence[Bar]) -> Table:
    """Return the bars, what was measured, and whether it is enough."""
    rows: list[Cells] = []
    for bar in bars:
        limit = f"{'≤' if bar.at_most else '≥'} {bar.demanded:g}"
        rows.append([bar.name, limit, bar.measured, "PASS" if bar.passed else "FAIL"])
    return Table("## Bars", ["bar", "demanded", "measured", "verdict"], rows, formats=("", "", ".4g"))


if __name__ == "__main__":
    main()
