"""Command line of scripts/soak: sections of attacks, as tables of docs/appendix/reliability-results.md."""

import argparse
import platform
import warnings
from collections.abc import Callable, Iterator
from itertools import chain
from pathlib import Path
from tempfile import TemporaryDirectory

from study import Table, write_between

from tests.faults import (
    cost,
    damage,
    disk,
    documents,
    endurance,
    fuzz,
    interrupts,
    killed,
    line,
    medium,
    rack,
    recovery,
    viewer,
)
from tests.faults.rows import Row

DOCS = Path(__file__).parents[2] / "docs" / "appendix" / "reliability-results.md"
Section = Callable[[Path, bool], Iterator[Row]]


def _killed(folder: Path, short: bool) -> Iterator[Row]:
    for rate_hz in (100.0, 1000.0):
        yield killed.kill_many(folder, rate_hz, 2 if short else 50, 1)
    yield from killed.interrupt_all(folder, 1 if short else 5)


def _medium(folder: Path, short: bool) -> Iterator[Row]:
    for rate_hz in (100.0, 1000.0, 10_000.0):
        yield medium.measure(folder, rate_hz, 3.0 if short else 20.0)


def _endurance(folder: Path, short: bool) -> Iterator[Row]:
    yield endurance.accelerated(folder, 400.0, 0.1 if short else 2.0)
    yield endurance.real_time(folder, 1000.0, 0.5 if short else 30.0)
    yield from viewer.attack_all(folder / "stopped", 10.0 if short else 1800.0, [viewer.STOPPED])


def _days(folder: Path, short: bool) -> Iterator[Row]:
    yield endurance.accelerated(folder, 400.0, 0.1 if short else 24.0)
    yield endurance.real_time(folder, 100.0, 0.5 if short else 60.0)


def _rack(folder: Path, short: bool) -> Iterator[Row]:
    for view in ("none", "web"):
        (folder / view).mkdir()
        yield rack.measure(folder / view, 4 if short else 16, 400.0, 0.25 if short else 10.0, view)


SECTIONS: dict[str, Section] = {
    "damage": lambda folder, short: chain(
        damage.attack_all(folder, 10 if short else 100, 1), damage.truncate_all(folder, 41 if short else 1)
    ),
    "line": lambda folder, short: line.attack_all(folder, 1 if short else 10, 1),
    "killed": _killed,
    "disk": lambda folder, short: disk.attack_all(folder, 1 if short else 5),
    "viewer": lambda folder, short: viewer.attack_all(folder, 2.0 if short else 20.0),
    "medium": _medium,
    "documents": lambda folder, _: documents.attack_all(folder),
    "fuzz": lambda _, short: fuzz.fuzz_all(50 if short else 5000, 1),
    "streams": lambda _, short: fuzz.stream_all(2_000 if short else 10_000_000, 1),
    "interrupts": lambda folder, short: interrupts.interrupt_all(
        folder, interrupts.moments()[:: 10 if short else 1]
    ),
    "cost": lambda _, short: cost.measure_all(("ax1", "sbg") if short else None),
    "recovery": lambda _, short: recovery.attack_rows(
        ["one sample of 1e30", "10 s of NaN, all"] if short else None
    ),
    "devices": lambda _, short: recovery.variant_rows(("0.1 Hz", "all constant zero") if short else None),
    "endurance": _endurance,
}
LONG: dict[str, Section] = {"days": _days, "rack": _rack}
"""Sections that are run by their name only: they take long, or a computer with nothing else to do."""


def main() -> int:
    """Run the sections; return 1 when something did not hold."""
    warnings.simplefilter("ignore")
    parser = argparse.ArgumentParser(prog="scripts/soak", description=__doc__)
    parser.add_argument("sections", nargs="*", metavar="SECTION", help=f"of {', '.join(SECTIONS | LONG)}")
    parser.add_argument("--short", action="store_true", help="few times each: a minute or two in all")
    parser.add_argument("--write", action="store_true", help=f"write the tables into {DOCS.name}")
    options = parser.parse_args()
    if unknown := set(options.sections) - (SECTIONS | LONG).keys():
        parser.error(f"no section {', '.join(sorted(unknown))}; there are: {', '.join(SECTIONS | LONG)}")
    held = True
    for name in options.sections or SECTIONS:
        with TemporaryDirectory() as folder:
            rows = []
            for row in (SECTIONS | LONG)[name](Path(folder), options.short):
                print(
                    f"{'held' if row.held else 'FAIL'}  {row.fault} ({row.times}): {row.outcome}", flush=True
                )
                rows.append(row)
        held = held and all(row.held for row in rows)
        if options.write:
            write(name, rows, options.short)
    return int(not held)


def write(name: str, rows: list[Row], short: bool) -> None:
    """Put a table between the markers of its section."""
    cells = [[row.fault, f"{row.times:,}", row.outcome, "yes" if row.held else "**no**"] for row in rows]
    form = f"{name} --short" if short else name
    command = f"`scripts/soak {form}`, on {platform.machine()}, Python {platform.python_version()}:"
    table = Table(command, ["fault", "times tried", "outcome", "held"], cells)
    write_between(DOCS, f"soak {name}", table.markdown())


if __name__ == "__main__":
    raise SystemExit(main())
