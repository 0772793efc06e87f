"""Numbers that a page repeats are those of the committed tables."""

from __future__ import annotations

import math
import re
from pathlib import Path

import pytest

DOCS = Path(__file__).parents[1] / "docs"
ALIGNMENT = "appendix/alignment-details.md"
NUMBER = re.compile(r"-?\d+(?:\.\d+)?")


def text(page: str) -> str:
    """Return a page of the docs with each line break as a space."""
    return " ".join((DOCS / page).read_text(encoding="utf-8").split("\n"))


def tables(page: str) -> list[list[list[str]]]:
    """Return the cells of each table of a page, its head first."""
    found: list[list[list[str]]] = [[]]
    for line in (DOCS / page).read_text(encoding="utf-8").splitlines():
        if line.startswith("|"):
            found[-1].append([cell.strip() for cell in line.strip("|").split("|")])
        elif found[-1]:
            found.append([])
    return [[table[0], *table[2:]] for table in found if table]


def numbers(cells: list[str]) -> list[str]:
    return [number for cell in cells for number in NUMBER.findall(cell)]


def is_rounded(number: str, of: list[str]) -> bool:
    """Return whether a number is one of these, rounded to the places that it has."""
    half = 0.5001 * 10.0 ** -len(number.partition(".")[2])
    return any(abs(float(number) - float(one)) <= half for one in of)


def numbers_in(page: str, pattern: str) -> list[float]:
    match = re.search(pattern, text(page))
    assert match, f"{page} has no {pattern}"
    return [float(number) for number in match.groups()]


@pytest.mark.parametrize(
    ("page", "appendix", "at_least"),
    [
        (ALIGNMENT, "alignment-site-results.md", 20),
        ("alignment.md", "alignment-site-results.md", 4),
        ("batch.md", "performance-table.md", 2),
        ("performance.md", "performance-table.md", 7),
    ],
)
def test_rows_of_a_page_are_those_of_the_appendix(page: str, appendix: str, at_least: int) -> None:
    source = {row[0]: numbers(row[1:]) for table in tables(f"appendix/{appendix}") for row in table[1:]}
    rows = [row for table in tables(page) for row in table[1:] if row[0] in source]
    assert len(rows) >= at_least
    for row in rows:
        assert all(is_rounded(number, source[row[0]]) for number in numbers(row[1:])), row


def test_kinds_of_sites_and_what_is_reported_of_them() -> None:
    sites, _, creeps = tables("appendix/alignment-site-results.md")
    kinds = [len(sites) - 1, len(creeps) - 1]
    assert numbers_in(ALIGNMENT, r"runs (\d+) kinds of sites and (\d+) of creeps") == kinds
    assert numbers_in("appendix/README.md", r"on (\d+) kinds of sites and (\d+) of creeps") == kinds
    value = {name: [float(row[k].strip("% ")) for row in sites[1:]] for k, name in enumerate(sites[0]) if k}
    shown = [
        n for n in range(kinds[0]) if not any(math.isnan(value[f"rms error °, {s} s"][n]) for s in (60, 600))
    ]
    counts = {
        (what, s): sum(value[f"{what}, {s} s"][n] <= limit for n in shown)
        for what, limit in (("over the better mean", 1.5), ("rms z", 1.8), ("max z", 5.0))
        for s in (60, 600)
    }
    pattern = (
        r"(\d+) sites have a heading.* in (\d+) \(60 s\) and (\d+) \(600 s\); .* "
        r"below 1.8 in (\d+) and all (\d+), the largest below 5 in (\d+) and (\d+)"
    )
    assert numbers_in(ALIGNMENT, pattern) == [len(shown), *counts.values()]


def test_number_of_simulated_cases() -> None:
    cases = numbers_in("appendix/closing-the-loop-results.md", r"(\d+) of its \d+ cases")
    assert numbers_in("appendix/README.md", r"(\d+) simulated cases") == cases
    assert numbers_in("closing-the-loop.md", r"are of all (\d+) cases") == cases


def test_worst_seeds_of_the_bias_race() -> None:
    results = "appendix/bias-race-results.md"
    worst = [float(row[2]) for table in tables(results) for row in table if row[0] == "imumon thermal"]
    assert numbers_in(results, r"warm-up, worst of the seeds: ([\d.]+) ") == worst[:1]
    assert numbers_in(results, r"ramp, worst of the seeds: ([\d.]+) ") == worst[1:]


def test_summary_of_the_bias_race() -> None:
    summary, _, place = tables("bias-race.md")
    found = [table for table in tables("appendix/bias-race-results.md") if table[0][1] == "rms"]
    cases = [{row[0]: row[1:3] for row in table} for table in found]
    names = ("mean of each rest", "VQF, tuned", "imumon standard", "imumon learned", "imumon thermal")
    for name, row in zip(names, summary[1:], strict=True):
        assert row[2:] == ["{} ({})".format(*case[name]) if name in case else "" for case in cases]
    order = {"warm-up": 0, "ramp": 1, "no thermal effect": 2}
    for row in place[1:]:
        mode, case = row[0].replace("`", "").split(", ")
        of = cases[order[case]]
        assert row[1:] == [of[f"imumon {mode}"][0], of[f"imumon {mode}, place unknown"][0]]
    modes = {row[0].strip("`"): row[3] for row in tables("tczupt.md")[0][1:]}
    assert modes == {name: f"{cases[0][f'imumon {name}'][0]} °/h" for name in modes}


def test_thermal_calibration() -> None:
    page = "appendix/thermal-calibration-results.md"
    chosen = next(row for table in tables(page) for row in table if "its choice" in row[0])
    said = numbers_in("thermal-calibration.md", r"found to ([\d.]+) / ([\d.]+) / ([\d.]+) °/h/°C")
    assert said == [float(cell) for cell in chosen[1:4]]
    cycle = [table for table in tables(page) if "chosen" in table[0]][1]
    measured = "appendix/closing-the-loop-measured.md"
    parts = [row for table in tables(measured) for row in table if row[0] == "60%"]
    shown = tables("thermal-calibration.md")[-1][1:]
    assert [row[0] for row in shown] == ["x", "y", "z"]
    for row, before, after in zip(shown, cycle[1:], parts, strict=True):
        assert (row[0], row[0]) == (before[0], after[1])
        sources = ([before[1]], [before[6]], [after[6]])
        assert all(is_rounded(number, source) for number, source in zip(row[1:], sources, strict=True))
    pattern = r"x falls from ([\d.]+) to ([\d.]+) °/s, still (\d+) floors"
    floors = float(parts[0][6]) / float(parts[0][2])
    assert numbers_in("closing-the-loop.md", pattern) == [*map(float, shown[0][2:]), round(floors)]


def test_random_error() -> None:
    others = tables("appendix/random-error-details.md")
    drift = {row[0]: [row[1], row[3]] for row in next(each for each in others if "rms error / sd" in each[0])}
    names = ("drift", "exponential 200 s", "hold 60 s", "SR-UKF, δ¹ 3.9e-05", "SR-RSUKF 0.5, δ¹ 3.9e-05")
    shown = [row[1:] for row in tables("random-error.md")[2][1:]]
    assert shown == [drift[name] for name in (*names, "STF, δ¹ 3.9e-05")]
    angle = {row[0]: row[1:] for row in next(each for each in others if each[0][-1] == "of which drift")}
    pattern = (
        r"angle by ([\d.]+)° rms if nothing .* by ([\d.]+)° if the default is. White noise adds ([\d.]+)°"
    )
    sources = [angle["nothing"][1], angle["drift"][1], angle["the truth"][0]]
    assert numbers_in("random-error.md", pattern) == [round(float(one), 2) for one in sources]


def test_bias_at_corners_of_a_profile() -> None:
    shares = [
        float(row[3].partition("% ")[2].partition(",")[0])
        for table in tables("appendix/field-results.md")
        for row in table
        if re.match(r"(triangle|trapezoid) of 1 °C/min, .*: bias", row[1])
    ]
    page = "appendix/tczupt-details.md"
    said = numbers_in(page, r"the bias is off by more than 5 sigma for ([\d.]+) to ([\d.]+) %")
    assert said == [round(min(shares), 2), round(max(shares), 2)]
