"""What each mechanism and constant of an estimator is worth: one row for each, switched off or changed.

A part is a module `ablation_NAME_part.py` with `TITLE` (a sentence), `VARIANTS` (a name, and what is changed,
of any type) and `outcomes(change, seeds, data)`, which yields an `Outcome` for each scene; None
changes nothing.
"""

from __future__ import annotations

import argparse
import os
import sys
from collections.abc import Iterator, Mapping
from importlib import import_module
from itertools import islice
from pathlib import Path
from typing import Any, Protocol, cast

import numpy as np
from ablation_outcome import Outcome

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "appendix" / "ablation-results.md"
PARTS = tuple(
    sorted(path.stem.removeprefix("ablation_") for path in Path(__file__).parent.glob("ablation_*_part.py"))
)
HEAD = """# What each mechanism is worth

Written by `scripts/reproduce/ablation`, a part per estimator.  Each row is the estimator with one mechanism
switched off or one constant changed: the geometric mean of its errors over those of the estimator as it is,
the scene that changes most, and the error over sigma, rms over all scenes and largest.  A mechanism stays if
it is worth 15 % of an error in a scene, or honesty.
"""


class Part(Protocol):
    """A module of an estimator's ablations."""

    TITLE: str
    VARIANTS: Mapping[str, Any]

    def outcomes(self, change: object, seeds: range, data: Path) -> Iterator[Outcome]:
        """Yield the outcome of every scene with a change; None changes nothing."""


def rows(part: Part, seeds: range, data: Path, most: int | None) -> Iterator[str]:
    """Yield the lines of a part's table."""
    base = list(islice(part.outcomes(None, seeds, data), most))
    yield "| change | error, × | worst scene, × | error/σ rms | max |"
    yield "|---|---|---|---|---|"
    yield line("none", base, base)
    for name, change in islice(part.VARIANTS.items(), most):
        yield line(name, list(islice(part.outcomes(change, seeds, data), most)), base)


def line(name: str, found: list[Outcome], base: list[Outcome]) -> str:
    """Return a row: errors of a variant over those of the base."""
    ratios = np.array([(a.error + a.floor) / (b.error + b.floor) for a, b in zip(found, base, strict=True)])
    worst = int(np.argmax(np.abs(np.log(ratios))))
    z = float(np.sqrt(np.mean([outcome.z**2 for outcome in found])))
    largest = max(outcome.largest for outcome in found)
    mean = float(np.exp(np.mean(np.log(ratios))))
    return f"| {name} | {mean:.2f} | {ratios[worst]:.2f} ({found[worst].scene}) | {z:.2f} | {largest:.1f} |"


def write(name: str, title: str, lines: list[str], page: Path) -> None:
    """Put a part's table in place of the one in the page, or at its end."""
    text = page.read_text(encoding="utf-8") if page.exists() else HEAD
    heading = f"## {name}\n"
    begin, _, rest = text.partition(heading)
    _, found, behind = rest.partition("\n## ")
    section = f"{heading}\n{title}\n\n" + "\n".join(lines) + "\n"
    begin = begin if begin.endswith("\n\n") else begin.rstrip("\n") + "\n\n"
    page.write_text(begin + section + (f"\n## {behind}" if found else ""), encoding="utf-8")


def main() -> None:
    """Print the tables and write them into the page."""
    default = os.environ.get("IMUMON_DATA", str(ROOT.parent / "shared" / "data"))
    parser = argparse.ArgumentParser(prog="scripts/reproduce/ablation", description=__doc__)
    names = [name.removesuffix("_part") for name in PARTS]
    parser.add_argument("--part", choices=names, action="append", help="only this estimator")
    parser.add_argument("--seeds", type=int, default=2, help="runs of each scene (default: %(default)s)")
    parser.add_argument("--first", type=int, default=3000, help="first seed (default: %(default)s)")
    parser.add_argument("--data", type=Path, default=Path(default), help="folder of the measured recordings")
    parser.add_argument("--quick", action="store_true", help="one seed, two scenes, two rows; writes nothing")
    given = parser.parse_args()
    seeds = range(given.first, given.first + (1 if given.quick else given.seeds))
    for name in given.part or names:
        part = cast(Part, import_module(f"ablation_{name}_part"))
        lines = []
        for text in rows(part, seeds, given.data, 2 if given.quick else None):
            print(text, flush=True)
            lines.append(text)
        if not given.quick:
            write(name, f"{part.TITLE}  Seeds {seeds[0]} to {seeds[-1]}.", lines, PAGE)
            print(PAGE.relative_to(ROOT), file=sys.stderr)


if __name__ == "__main__":
    main()
