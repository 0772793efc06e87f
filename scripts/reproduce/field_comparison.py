"""Rows of `field_table.py` beside those of another version: errors, ratios, and sigmas that are too small."""

from __future__ import annotations

import json
import sys
from collections import defaultdict
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

RMS_ALLOWED, LARGEST_ALLOWED = 1.8, 7.0
"""Error over sigma, rms and largest, above which a row is listed."""
FLOORS = {"°C/h": 0.1, "°C": 0.005, "°/h": 0.01, "°": 0.01, "% false": 0.1}
"""Added to both errors before their ratio, so that a ratio of two errors that are next to nothing is one."""

Saved = Mapping[str, Any]


def save(rows: Sequence[Saved], path: Path) -> None:
    """Write rows, one JSON object per line."""
    path.write_text(
        "".join(json.dumps(dict(row), ensure_ascii=False) + "\n" for row in rows), encoding="utf-8"
    )


def load(path: Path) -> list[Saved]:
    """Return rows that `save` wrote.  Ends the program where the file holds none."""
    try:
        return [json.loads(line) for line in path.read_text(encoding="utf-8").splitlines() if line]
    except (OSError, ValueError) as error:
        sys.exit(f"{path}: no rows of scripts/reproduce/field --out: {error}")


def ratio(new: Saved, old: Saved) -> float:
    """Return the error of a row over that of the other version; NaN where either is missing."""
    floor = FLOORS.get(new["unit"], 0.0)
    if new["error"] is None or old["error"] is None:
        return float("nan")
    return float((new["error"] + floor) / (old["error"] + floor))


def show_beside(rows: Sequence[Saved], others: Sequence[Saved]) -> None:
    """Print new, old and ratio, the largest first; geometric means per part; rows with too small sigmas."""
    known = {(row["part"], row["kind"]): row for row in others}
    pairs = [(row, known[row["part"], row["kind"]]) for row in rows if (row["part"], row["kind"]) in known]
    print("\n| part | kind | new | old | ratio | error/σ new | old | max new | old |\n" + "|---" * 9 + "|")
    ratios: dict[str, list[float]] = defaultdict(list)
    for new, old in sorted(pairs, key=lambda pair: -np.nan_to_num(ratio(*pair))):
        ratios[new["part"]].append(ratio(new, old))
        cells = [new["part"], new["kind"], f"{new['error']:.3g} {new['unit']}", f"{old['error']:.3g}"]
        cells += [f"{ratio(new, old):.2f}", f"{new['z']:.2f}", f"{old['z']:.2f}"]
        print("| " + " | ".join([*cells, f"{new['zmax']:.1f}", f"{old['zmax']:.1f}"]) + " |")
    print("\n| part | rows | geometric mean of new / old | CPU s new | old |\n" + "|---" * 5 + "|")
    for part, values in ratios.items():
        mean = float(np.exp(np.nanmean(np.log(values))))
        seconds = (sum(pair[i]["cpu"] for pair in pairs if pair[0]["part"] == part) for i in (0, 1))
        print(f"| {part} | {len(values)} | {mean:.2f} | " + " | ".join(f"{x:.0f}" for x in seconds) + " |")
    print(f"\nError over sigma above {RMS_ALLOWED} rms or {LARGEST_ALLOWED} at the most:\n")
    print("| part | kind | rms new | old | max new | old |\n" + "|---" * 6 + "|")
    for new, old in pairs:
        if new["z"] > RMS_ALLOWED or new["zmax"] > LARGEST_ALLOWED:
            cells = [f"{new['z']:.2f}", f"{old['z']:.2f}", f"{new['zmax']:.1f}", f"{old['zmax']:.1f}"]
            print("| " + " | ".join([new["part"], new["kind"], *cells]) + " |")
