"""The runner of the studies: options, tables in Markdown, and pages.

A study is a module with `STUDY`.  It defines which scenes, methods and errors make a table; all else is here.
"""

import argparse
import os
import sys
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from contextlib import nullcontext
from dataclasses import dataclass
from importlib import import_module
from itertools import zip_longest
from pathlib import Path
from types import ModuleType
from typing import TypeVar, cast

import numpy as np

from imumon.blocks import FloatArray, SampleBlock

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
RMS_BAR, LARGEST_BAR = 1.8, 7.0
"""Error over sigma, rms and largest, beyond which a row is bad."""
STUDIES: Mapping[str, Mapping[str, str]] = {
    "ablation": {
        "alignment": "ablation_alignment_part",
        "temperature_rate": "ablation_temperature_rate_part",
        "attitude": "ablation_attitude_part",
        "rest_and_bias": "ablation_rest_and_bias_part",
    },
    "alignment_site": {"": "alignment_site"},
    "allan_terms": {"": "allan_terms_study"},
    "attitude": {"": "attitude_table", "worked": "attitude_worked", "straight": "attitude_worked:STRAIGHT"},
    "bias_race": {"": "bias_race_study"},
    "closing_the_loop": {
        "simulated": "closing_the_loop_statistics",
        "live": "closing_the_loop_live",
        "plans": "closing_the_loop_plans",
        "measured": "closing_the_loop_measured",
        "ablation": "closing_the_loop_ablation",
    },
    "field": {
        "rest": "field_table:REST",
        "thermometer": "field_table:THERMOMETER",
        "bias": "field_table:BIAS",
        "moving": "field_table:MOVING_BIAS",
        "surprises": "field_table:SURPRISE",
        "measured": "field_table:MEASURED",
    },
    "pictures": {"": "pictures"},
    "random_error": {"": "random_error_study"},
    "smoothing": {"": "smoothing_table"},
    "tczupt": {"": "tczupt_study"},
    "thermal_calibration": {"": "thermal_calibration_study"},
}
"""Where each study is, MODULE or MODULE:NAME, by command and `--part`; the first is the default."""
Job = TypeVar("Job")
Result = TypeVar("Result")


@dataclass(frozen=True)
class Options:
    """What the command line gives a study: scenes whose name holds `only`, recordings in the folder `data`,
    with `quick` the first of everything, and so many processes."""

    seeds: range
    only: str
    data: Path
    quick: bool
    jobs: int


Cell = str | float
Cells = Sequence[Cell]


@dataclass(frozen=True)
class Table:
    """A table with a title above and a note below; numbers have the format of their column."""

    title: str
    heads: Sequence[str]
    rows: Sequence[Cells]
    note: str = ""
    formats: Sequence[str] = ()

    def markdown(self) -> str:
        """Return the table in Markdown."""
        lines = [f"{self.title}\n"] if self.title else []
        lines += [f"| {' | '.join(self.heads)} |", "|---" * len(self.heads) + "|"] if self.rows else []
        for row in self.rows:
            cells = [
                cell if isinstance(cell, str) else format(cell, form)
                for cell, form in zip_longest(row, self.formats[: len(row)], fillvalue="")
            ]
            lines.append(f"| {' | '.join(cells)} |")
        return "\n".join([*lines, f"\n{self.note}"] if self.note else lines) + "\n"


@dataclass(frozen=True)
class Study:
    """A study: what yields its tables, runs of each scene and their first seed by default, and the page below
    docs that `--write` puts the tables into, between markers with the name of the study or its part."""

    tables: Callable[[Options], Iterable[Table]]
    seeds: int = 1
    first: int = 0
    page: str = ""


def rms(values: FloatArray | Sequence[float]) -> float:
    """Return the root mean square of what is known; NaN of nothing."""
    known = np.asarray(values, np.float64)
    known = known[np.isfinite(known)]
    return float(np.sqrt(np.mean(known**2))) if len(known) else np.nan


def largest(values: FloatArray) -> float:
    """Return the largest absolute value of what is known; NaN of nothing."""
    known = np.abs(values[np.isfinite(values)])
    return float(known.max()) if len(known) else np.nan


def over_bar(ratios: FloatArray) -> float:
    """Return how far errors over sigma are beyond their bars: 1 is just allowed."""
    return float(np.nanmax([0.0, rms(ratios) / RMS_BAR, largest(ratios) / LARGEST_BAR]))


def matrix(samples: SampleBlock, name: str) -> FloatArray:
    """Return the three columns of a vector, (n, 3)."""
    return np.column_stack([samples[f"{name}_{axis}"] for axis in "xyz"])


def spread(function: Callable[[Job], Result], work: Sequence[Job], jobs: int) -> Iterator[Result]:
    """Yield the results of a function in the order of its arguments, from so many processes; 1 is this."""
    with ProcessPoolExecutor(jobs) if jobs > 1 else nullcontext() as pool:
        results = map(function, work) if pool is None else pool.map(function, work)
        for done, result in enumerate(results, 1):
            print(f"\r{done}/{len(work)}", end="", file=sys.stderr)
            yield result
    print(file=sys.stderr)


def worst_first(rows: Iterable[tuple[float, Cells]]) -> list[Cells]:
    """Return the cells of rows, those with the largest number first."""
    return [cells for _, cells in sorted(rows, key=lambda row: -row[0])]


def write_between(page: Path, name: str, text: str) -> None:
    """Put text between the markers of this name in a page."""
    begin, end = f"<!-- {name} -->\n", f"<!-- end {name} -->"
    before, found, rest = page.read_text(encoding="utf-8").partition(begin)
    _, closed, after = rest.partition(end)
    if not (found and closed):
        raise SystemExit(f"{page} has no markers {begin.strip()} and {end}")
    page.write_text(f"{before}{begin}{text}{end}{after}", encoding="utf-8")


def parser_of(
    command: str, study: Study, about: str | None, part: argparse.ArgumentParser
) -> argparse.ArgumentParser:
    """Return the command line of a study."""
    parser = argparse.ArgumentParser(prog=f"scripts/reproduce/{command}", description=about, parents=[part])
    data = os.environ.get("IMUMON_DATA", str(ROOT.parent / "shared" / "data"))
    parser.add_argument(
        "--seeds", "--repeat", type=int, default=study.seeds, help="runs of each scene (%(default)s)"
    )
    parser.add_argument("--first", type=int, default=study.first, help="first seed (%(default)s)")
    parser.add_argument("--only", default="", help="scenes, or changes, with this text in their name")
    parser.add_argument("--data", type=Path, default=data, help="folder of the measured recordings")
    parser.add_argument("--jobs", type=int, default=2, help="processes, where a study has some (%(default)s)")
    parser.add_argument("--quick", action="store_true", help="the first of everything, in seconds")
    if study.page:
        parser.add_argument("--write", action="store_true", help=f"write the tables into docs/{study.page}")
    return parser


def study_of(place: str) -> tuple[ModuleType, Study]:
    """Return the module of a study and the study, given its place in `STUDIES`."""
    name, _, attribute = place.partition(":")
    module = import_module(name)
    return module, cast(Study, getattr(module, attribute or "STUDY"))


def main(command: str, arguments: Sequence[str]) -> None:
    """Run a study."""
    if command not in STUDIES:
        raise SystemExit(f"scripts/reproduce/NAME [--help], where NAME is one of {', '.join(STUDIES)}")
    parts = STUDIES[command]
    part = argparse.ArgumentParser(add_help=False)
    if len(parts) > 1:
        part.add_argument("--part", choices=list(parts))
    name = getattr(part.parse_known_args(arguments)[0], "part", None) or next(iter(parts))
    module, study = study_of(parts[name])
    given = parser_of(command, study, module.__doc__, part).parse_args(arguments)
    count, jobs = (1, 1) if given.quick else (given.seeds, given.jobs)
    seeds = range(given.first, given.first + count)
    options = Options(seeds, given.only, given.data, given.quick, jobs)
    done = []
    for table in study.tables(options):
        done.append(table.markdown())
        print(done[-1], flush=True)
    if study.page and given.write:
        write_between(DOCS / study.page, name or command, "\n".join(done))


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2:])
