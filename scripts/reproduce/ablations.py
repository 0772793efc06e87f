"""What each mechanism and constant of an estimator is worth: one row for each, switched off or changed."""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from typing import Any
from unittest.mock import patch

import numpy as np
from study import Cells, Options, Study, Table, rms

PAGE = "appendix/ablation-results.md"
HEADS = ("change", "error, ×", "worst scene, ×", "error/σ rms", "max")
FORMATS = ("", ".2f", "", ".2f", ".1f")
Change = Sequence[tuple[Any, str, Any]]
"""Module or class, a name in it, and what stands there instead."""


@dataclass(frozen=True, slots=True)
class Outcome:
    """What an ablation measures in one scene: rms error, error over sigma (rms and largest)."""

    scene: str
    error: float
    floor: float
    """Added to errors before their ratio, in their unit: what is next to nothing."""
    z: float
    largest: float


@contextmanager
def changed(change: Change) -> Iterator[None]:
    """Let a change hold for a while."""
    with ExitStack() as stack:
        for place, name, value in change:
            stack.enter_context(patch.object(place, name, value))
        yield


def row(name: str, found: Sequence[Outcome], base: Sequence[Outcome]) -> Cells:
    """Return a row: errors of a variant over those of the base."""
    ratios = np.array([(a.error + a.floor) / (b.error + b.floor) for a, b in zip(found, base, strict=True)])
    worst = int(np.argmax(np.abs(np.log(ratios))))
    mean = float(np.exp(np.mean(np.log(ratios))))
    largest = max(outcome.largest for outcome in found)
    shown = f"{ratios[worst]:.2f} ({found[worst].scene})"
    return [name, mean, shown, rms([outcome.z for outcome in found]), largest]


def ablation(
    title: str,
    variants: Mapping[str, Change],
    outcomes: Callable[[range, Path], Iterator[Outcome]],
) -> Study:
    """Return the study of an estimator's mechanisms: a sentence above the table, what is changed, by name,
    and what yields the outcome of every scene, on seeds and a folder of recordings."""

    def tables(given: Options) -> Iterator[Table]:
        most = 2 if given.quick else None
        base = list(islice(outcomes(given.seeds, given.data), most))
        rows = [row("none", base, base)]
        chosen = {name: change for name, change in variants.items() if given.only in name}
        for name, change in islice(chosen.items(), most):
            with changed(change):
                rows.append(row(name, list(islice(outcomes(given.seeds, given.data), most)), base))
            full = f"{title}  Seeds {given.seeds[0]} to {given.seeds[-1]}."
            yield Table(full, HEADS, rows, formats=FORMATS)

    return Study(tables, seeds=2, first=3000, page=PAGE)
