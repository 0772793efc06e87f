"""Numbers that a page repeats are those of the committed tables."""

from __future__ import annotations

import math
import re
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest
from pictures import heated_unit
from scipy.optimize import brentq

from imumon.allan.covariance import FLOOR_PER_INSTABILITY
from imumon.allan.fit import SHOWN
from imumon.cli.align_command import HOPELESS_S, LONGEST_S
from imumon.estimation.alignment.parameters import AlignmentParameters
from imumon.estimation.alignment.posterior import (
    LOG_SIZES,
    P_WORSE,
    P_WORSE_THAN_DECLARED,
    WORSE,
    sensor_errors,
)
from imumon.estimation.alignment.stage import LONGEST_GAP_S
from imumon.estimation.attitude.fusion import TAU_ACC_S
from imumon.estimation.attitude.sigma import CONFIRMING_TURN, IRON
from imumon.estimation.gyro_bias.bank import SENSITIVITY_SD
from imumon.estimation.gyro_bias.hypotheses import LAG_S
from imumon.estimation.rest.odds import of_changed_bias
from imumon.estimation.rest.parameters import RestParameters
from imumon.estimation.smoothing.stage import MEDIAN
from imumon.estimation.temperature_rate.filter import CODE_MODELS, JERK_PSDS, MEAN_MODELS, WHITE_SDS
from imumon.estimation.temperature_rate.stage import RAMP_S, MultipleModelRate
from imumon.geodesy import DEG_PER_H, EARTH_RATE, MICRO_G, STANDARD_GRAVITY
from imumon.papers.dense_zupt import DenseSettings
from imumon.papers.fir import FirRate, Params
from imumon.papers.local_level import TO_INSTABILITY
from imumon.papers.self_alignment import CORNER, DAMPING
from imumon.papers.stages import DEFAULT_STEP_DEGC
from imumon.protocols.thermometer import TemperatureRateParameters
from imumon.run.live import BATCH_S

DOCS = Path(__file__).parents[1] / "docs"
ALIGNMENT, METHOD = "appendix/alignment-details.md", "appendix/alignment-method.md"
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
        (ALIGNMENT, "alignment-site-results.md", 6),
        ("alignment.md", "alignment-site-results.md", 4),
        ("batch.md", "performance-table.md", 2),
        ("appendix/performance-details.md", "performance-table.md", 1),
        ("smoothing.md", "smoothing-details.md", 2),
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
    assert numbers_in(ALIGNMENT, r"simulates (\d+) kinds of sites and (\d+) of creeps") == kinds
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
    assert numbers_in(ALIGNMENT, r"(\d+) of the (\d+) sites have a heading") == [len(shown), kinds[0]]
    pattern = (
        r"at most 1.5 times that of the better [^|]* \| (\d+) \| (\d+) \| "
        r"\| rms of error over sigma at most 1.8 \| (\d+) \| (\d+) \| "
        r"\| largest error over sigma at most 5 \| (\d+) \| (\d+) \|"
    )
    assert numbers_in(ALIGNMENT, pattern) == list(counts.values())


def median_bias(arw: float) -> float:
    """Return the median of the prior of the alignment's gyro bias, °/h, for a noise in °/√h."""
    errors = sensor_errors(math.radians(arw) / 60.0, AlignmentParameters())
    return float(errors.sizes[len(LOG_SIZES) // 2, 0]) / DEG_PER_H


def test_number_of_simulated_cases() -> None:
    cases = numbers_in("appendix/closing-the-loop-results.md", r"(\d+) of its \d+ cases")
    assert numbers_in("appendix/README.md", r"(\d+) simulated cases") == cases
    assert numbers_in("closing-the-loop.md", r"are of all (\d+) cases") == cases
    results = tables("appendix/closing-the-loop-results.md")

    def right(floors: str) -> list[float]:
        rows = [row for table in results for row in table if row[1] == floors]
        return [sum(map(float, each)) for each in zip(*(numbers([row[2]])[:2] for row in rows), strict=True)]

    for page in ("closing-the-loop.md", "appendix/closing-the-loop-measured.md"):
        assert numbers_in(page, r"half a floor\S* (\d+) of (\d+) are named right") == right("0.5")
    small = numbers_in("closing-the-loop.md", r"of two floors (\d+) of (\d+), of one floor (\d+) of (\d+)")
    assert small == [*right("2"), *right("1")]


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
    promised = [[row[cycle[0].index("promised")]] for row in cycle[1:]]
    (shown_residual,) = shaped("thermal-calibration.md", "`residual` does not show it: #, # and # °/s")
    assert all(map(is_rounded, shown_residual, promised))
    parts_of_z = [row for table in tables(page) for row in table if row[0] == "z" and "polynomial" in row[7]]
    assert len(parts_of_z) == 3
    assert all(float(row[6]) > float(row[1]) for row in parts_of_z)  # "worse, whatever part is fitted"
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


class Source(NamedTuple):
    """Where numbers of a page come from: those at each # of a text, with * for anything within a cell.

    `of` makes what the page has of them: a list of the numbers of each place that fits.
    """

    page: str
    shape: str
    of: Callable[[list[list[float]]], list[float]] = lambda found: found[0]

    def values(self) -> list[float]:
        found = [[float(number) for number in groups] for groups in shaped(self.page, self.shape)]
        assert len(found) == 1 or self.of is not Source._field_defaults["of"], self
        return self.of(found)


def shaped(page: str, shape: str) -> list[list[str]]:
    """Return the numbers at each # of a text, for each place of a page that fits."""
    pattern = re.escape(shape).replace(r"\#", f"({NUMBER.pattern})").replace(r"\*", "[^|]*")
    found = [match.groups() for match in re.finditer(pattern, " ".join(text(page).split()))]
    assert found, f"{page} has no {shape}"
    return [list(groups) for groups in found]


def largest(found: list[list[float]]) -> list[float]:
    return [max(column) for column in zip(*found, strict=True)]


def least_and_largest(found: list[list[float]]) -> list[float]:
    return [min(map(min, found)), max(map(max, found))]


def largest_walk(lowest: list[float], unit: float, axis: int, scales: tuple[float, float]) -> list[float]:
    """Return lowest deviation in both units, its τ, and the walk that it allows, of the axis with most.

    `lowest`: three deviations and three τ; `scales`: of the deviation and of the walk in SI units.
    """
    walks = [unit * s * math.sqrt(3.0 / tau) for s, tau in zip(lowest[:3], lowest[3:], strict=True)]
    assert walks.index(max(walks)) == axis
    deviation = lowest[axis]
    return [deviation, scales[0] * unit * deviation, lowest[3 + axis], scales[1] * walks[axis]]


def shown_and_excess(found: list[list[float]]) -> list[float]:
    """Return the share of records with a term, %, and by how much the term is too large in them, %."""
    return [found[0][0], 100.0 * (found[0][1] - 1.0)]


def odds_of_change(dph: float) -> float:
    """Return the odds of a changed bias over a turn, by a change of the rate of so many °/h."""
    return of_changed_bias(dph * DEG_PER_H, 0, RestParameters().largest_jump)


def turn_at(probability: float) -> float:
    """Return at which change of the rate, °/h, a turn has this probability by the rate alone."""
    return float(brentq(lambda dph: odds_of_change(dph) + 1.0 - 1.0 / probability, 5.0, 1000.0))


NOWHERE = math.nan
"""A number of a page that no committed table, test or constant has: not compared."""
ABLATION, ATTITUDE, FIELD = (f"appendix/{name}-results.md" for name in ("ablation", "attitude", "field"))
ALLAN, ATTITUDE_DETAILS, REST, SMOOTHING, RATE, RANDOM, PUBLISHED = (
    f"appendix/{name}-details.md"
    for name in (
        *("allan", "attitude", "rest-detector", "smoothing", "temperature-rate", "random-error"),
        "published",
    )
)
SITES, SPEED, TCZUPT = (
    f"appendix/{name}.md" for name in ("alignment-site-results", "performance-table", "tczupt-results")
)
SPEED_DETAILS = "appendix/performance-details.md"
SPEEDS = "| x real time | # | # | # | # | # | # |"
"""Of a replay: at rest, with a latitude, handled; each at 100 and at 400 Hz."""
SOAK, JUMPED = "tutorials/soak.md", "../tests/estimation/smoothing/test_smoothing.py"
SURPRISES = "../scripts/reproduce/field_surprises.py"
WARMING = "../tests/estimation/gyro_bias/test_thermal.py"
LEVEL_RATE = EARTH_RATE * math.cos(math.radians(36.0)) / DEG_PER_H
"""Horizontal earth rate at the latitude of the alignment's examples, °/h."""
EARTH_DPH = EARTH_RATE / DEG_PER_H
AT_50 = EARTH_DPH * math.cos(math.radians(50.0))
NIGHT = "tutorials/a-night.md"
CRS05 = "../configs/units/crs05.yaml"
LOWEST_OF_GYROS = "lowest deviation °/h # # # at τ s # # #"
LOWEST_OF_ACCELS = "lowest deviation µg # # # at τ s # # #"
DENSE = DenseSettings(0.25)
PRINTED = math.sqrt(0.8 * STANDARD_GRAVITY)
"""Corner of the alignment loop by the gains that its paper prints, rad/s."""
DEGREE, TAN = math.degrees(1.0), math.tan(math.radians(36.0))
AFTER_60_S, AFTER_600_S = (1e-3 * math.sqrt(3600.0 / s) / LEVEL_RATE * DEGREE for s in (60.0, 600.0))
"""Sigma of the heading by a noise of 0.001 °/√h, °."""
BY_BIAS, BY_ACCEL = 0.0035 / LEVEL_RATE * DEGREE, 25e-6 * TAN * DEGREE
BY_SCALE = 10e-6 / math.cos(math.radians(36.0)) * DEGREE
"""And by the errors that are declared in its example."""
BY_TURN = math.degrees(EARTH_RATE * 10.0)

"""What a turn of half a circle in 10 s may be off by, as the earth rate moves through the axes, °."""
WORTH_A_TURN = [LEVEL_RATE * math.radians(math.hypot(BY_TURN, 180e-6 * ppm)) / 2.0 for ppm in (10.0, 300.0)]
"""Biases, °/h, that make as large an error as half a turn with scale errors of 10 and 300 ppm."""
TWO_CREEPS = "3° in 280 s, half a turn, 3° in 280 s, biases of 2 °/h"
LARGEST_JUMP = RestParameters().largest_jump / DEG_PER_H * (1.0 - 1e-9)
"""Largest jump of a bias that time decides, °/h."""
QUICK_TURN = "| rest | turn of 0.05 °/s for 10 min, begun in 0.5 s, 0° off the vertical, * "
SLOW_RAMP = "| rest | turn of 0.5 °/s for 10 min, begun in 120 s, 0° off the vertical, * "

NO_NUMBER = re.compile(r"`[^`]*`|\]\([^)]*\)")
"""Names and links, whose digits are none of a row's numbers."""

Numbers = list[float | Source]
ROWS: list[tuple[str, str, Numbers]] = [
    # attitude
    (
        "attitude.md",
        "| 02 slow rotation ",
        [2, Source(ATTITUDE, "| 02 undisturbed slow rotation B | # | * | * | # | # | * | * | # |")],
    ),
    (
        "attitude.md",
        "| 08 fast, with breaks ",
        [
            8,
            Source(
                ATTITUDE, "| 08 undisturbed fast rotation with breaks A | # | * | * | # | # | * | * | # |"
            ),
        ],
    ),
    (
        "attitude.md",
        "| one pose, accelerometers off by ",
        [
            Source(ATTITUDE, '"Consumer accelerometers": off by # mg'),
            Source(ATTITUDE, "| at rest, consumer accelerometers | * | * | * | * | * | # | # |", largest),
        ],
    ),
    (
        "attitude.md",
        "| gyro z reversed, confirmed about x ",
        [
            Source(ATTITUDE, f"| by hand, gyro z reversed | 50 | no |{' * |' * 9} # | # |"),
            2,  # the step of the page
        ],
    ),
    (
        "attitude.md",
        "| a magnet on the body, which ",
        [Source(ATTITUDE, f"| by hand, magnet on the body | 400 | yes |{' * |' * 9} # | # |")],
    ),
    ("attitude.md", "| magnetometer with other axes ", [NOWHERE]),
    (
        "attitude.md",
        "| 2 m/s² straight ahead ",
        [2, Source(ATTITUDE_DETAILS, "--part straight`): error over σ # after # s, # after # s")],
    ),
    # smoothing
    (
        "smoothing.md",
        "| the bias of all axes jumps ",
        [
            Source(JUMPED, "> 150 * RATE_HZ, np.radians(#)"),
            0.3 * 3600.0,
            Source(JUMPED, "r == pytest.approx([#, #, #]"),
            Source(JUMPED, "sd.max() == pytest.approx(#"),
            Source(JUMPED, "np.median(sd, axis=0) == pytest.approx([#, #, #]"),
            NOWHERE,  # the largest error over sigma of the same record
        ],
    ),
    ("smoothing.md", "| a chamber that changes its rate at once ", []),
    # temperature rate
    ("temperature-rate.md", "| 0.5 °C ", [0.5, Source(RATE, "| in steps of 0.5 °C | #; #, # |")]),
    ("temperature-rate.md", "| 1 °C ", [1, Source(RATE, "| in steps of 1 °C | #; #, # |")]),
    (
        "temperature-rate.md",
        "| first ",
        [Source(RATE, "beyond the sigma until a reading shows it: # to # s")],
    ),
    ("temperature-rate.md", "| cooling turns into heating ", [Source(RATE, "| as recorded | *, # |")]),
    (
        "temperature-rate.md",
        "| a triangle of temperature",
        [
            0.0625,
            Source(FIELD, "| triangle of 1 °C/min, steps of 0.0625 °C: temperature | * | * | * | * | # |"),
        ],
    ),
    (
        "temperature-rate.md",
        "| [popcorn noise]",
        [
            Source(
                RATE,
                "off by up to # of its sigmas (rms 15 for jumps of 3 steps, 60 s apart on average), "
                "the rate by up to #",
            )
        ],
    ),
    # Allan deviation
    (
        "allan.md",
        "| small B beside a small K",
        [Source(ALLAN, f"| N 1e-3, B 3e-4, K 3e-5 | {term} | # % | # |", shown_and_excess) for term in "BK"],
    ),
    (
        "allan.md",
        "| vibration, ",
        [
            0.1,
            Source(ALLAN, "| # Hz, A 1e-1; 5 Hz, A 1e-2 or 1e-1 | # of 18 |"),
            Source(ALLAN, "with a sine of amplitude A (rad/s), 20 minutes at 50 Hz, # seeds each"),
        ],
    ),
    (
        "allan.md",
        "| temperature cycle of ",
        [
            Source(ALLAN, "| cycle of # s, A 1e-3 or 1e-2 |"),
            Source(
                ALLAN, "| cycle of 300 s, A 1e-3 or 1e-2 | * | # to", lambda found: [100 - 100 * found[0][0]]
            ),
            Source(ALLAN, "| cycle of 300 s, A 1e-3 or 1e-2 | * | * | * | a random walk, in # |"),
            Source(ALLAN, "| cycle of 300 s, A 1e-3 or 1e-2 | # of 12 |"),
        ],
    ),
    ("allan.md", "| warm-up, or one step of the bias ", []),
    # rest
    (
        "rest-detector.md",
        "| 0.05 °/s, begun within ",
        [
            0.05,
            0.5,
            Source(REST, "a turn of 0.05 °/s (180 °/h) rest for # % (seed 31)"),
            Source(FIELD, f"{QUICK_TURN}| # % false |", largest),
            Source(REST, "and the least z, # (0.05 °/s, industrial) and"),
            Source(FIELD, f"{QUICK_TURN}| * | * | * | # | # |", largest),
        ],
    ),
    (
        "rest-detector.md",
        "| 0.5 °/s, begun and ended by ramps ",
        [
            0.5,
            120,
            Source(FIELD, f"{SLOW_RAMP}| # % false |", least_and_largest),
            Source(REST, "(0.05 °/s, industrial) and # (0.5 °/s, tactical)"),
            Source(FIELD, f"{SLOW_RAMP}| * | * | * | # | # |", largest),
        ],
    ),
    ("rest-detector.md", "| turns below ", [turn_at(0.1), LAG_S]),
    ("rest-detector.md", "| turns that begin slower ", [turn_at(0.25) / (2.0 * LAG_S), turn_at(0.25)]),
    (
        "rest-detector.md",
        "| a recording that begins in a turn ",
        [
            Source(REST, "the turn is detected after # to 8 s"),
            Source(REST, "or 15 to # s (0.3 °/s"),
            Source(REST, "It is mostly not detected at # °/s and less"),
        ],
    ),
    ("rest-detector.md", "| any jump of the bias ", [math.degrees(RestParameters().largest_jump)]),
    (
        "rest-detector.md",
        "| the bias jumps by 324 ",
        [
            turn_at(0.5),
            math.degrees(RestParameters().largest_jump),
            60,
            turn_at(0.5) / 60.0,
            *(math.sqrt(1.0 + 1.0 / odds_of_change(dph)) for dph in (turn_at(0.5), LARGEST_JUMP)),
            RestParameters().undecided_s / 3600.0,
        ],
    ),
    # gyro bias
    (
        "tczupt.md",
        "| the bias jumps by ",
        [
            Source(SURPRISES, "a bias that jumps by # to # deg/h every two minutes or so"),
            Source(FIELD, "| telegraph of the bias: bias | * | * | * | * | # |"),
            Source(FIELD, "| telegraph of the bias: bias | * | beyond # σ, % # |"),
        ],
    ),
    (
        "tczupt.md",
        "| vibration of a fan",
        [Source(FIELD, "| fan that the gyros rectify: bias | * | * | * | * | # |")],
    ),
    (
        "tczupt.md",
        "| a turn without accelerometers ",
        [math.sqrt(2.0) * SENSITIVITY_SD * STANDARD_GRAVITY / DEG_PER_H],
    ),
    ("tczupt.md", "| the thermometer is silent or stuck", [10, 60, 10 * 60]),
    (
        "tczupt.md",
        "| the temperature changes in motion",
        [Source(WARMING, '("standard", 0.0, 0, False, #)'), 2, Source(WARMING, "SLOPE = #")],
    ),
    (
        "tczupt.md",
        "| `learned`, a thermometer whose readings scatter",
        [Source(WARMING, '("learned", #, 2, True, *)'), Source(WARMING, '("learned", *, 2, True, #)'), 2],
    ),
    ("tczupt.md", "| a model, between two rests out of its range ", []),
    ("tczupt.md", "| slow turns that are called rest ", []),
    # alignment
    (
        "alignment.md",
        "| a bias of 3 °/h of only the gyro ",
        [
            3,
            math.degrees(math.atan(3.0 / LEVEL_RATE)),
            100.0 * (math.hypot(1.0, 3.0 / LEVEL_RATE) - 1.0),
            Source(SITES, f"| bias of 3 °/h of the gyro that points east |{' * |' * 18} # |"),
        ],
    ),
    (
        "alignment.md",
        "| a tripod that tilts by ",
        [
            Source(SITES, "| settling # µrad, 3000 s |"),
            3000,
            Source(SITES, f"| settling 2000 µrad, 3000 s |{' * |' * 18} # |"),
            5,
            Source(SITES, f"| settling 2000 µrad, 3000 s |{' * |' * 19} # % |"),
        ],
    ),
    (
        "alignment.md",
        "| a turn within a gap ",
        [
            LONGEST_GAP_S,
            Source(ALIGNMENT, "in a test # s after a turn by 5°, and # s after one by 30°"),
        ],
    ),
    ("alignment.md", "| accelerometers that log gravity", []),
    ("alignment.md", "| a quiet gyro with a [scale error]", [1, 180.0 * 0.01, 90.0 * 0.01]),
    # random error
    (
        "random-error.md",
        "| flicker over five decades ",
        [Source(RANDOM, "| drift | * | * | # |", lambda found: [1.0 / found[0][0]])],
    ),
    (
        "random-error.md",
        "| the drift is a pure random walk",
        [
            2e-7 * 60.0 / DEG_PER_H,
            0.28,
            Source("../tests/estimation/gyro_bias/test_consistency.py", "[(2e-7, #), (2e-5, 1.0)]"),
            2e-5 * 60.0 / DEG_PER_H,
        ],
    ),
]
"""Page, beginning of a row, and what each number of that row is."""


@pytest.mark.parametrize(("page", "row", "sources"), ROWS)
def test_numbers_of_a_row_are_those_of_its_sources(page: str, row: str, sources: Numbers) -> None:
    lines = [line for line in (DOCS / page).read_text(encoding="utf-8").splitlines() if line.startswith(row)]
    assert len(lines) == 1, f"{page} has {len(lines)} rows that begin with {row}"
    compare(NUMBER.findall(NO_NUMBER.sub("", lines[0])), sources)


def compare(shown: list[str], sources: Numbers) -> None:
    """Compare numbers of a page with their sources, rounded to the places that the page has."""
    values = [value for each in sources for value in (each.values() if isinstance(each, Source) else [each])]
    assert len(shown) == len(values), (shown, values)
    for number, value in zip(shown, values, strict=True):
        half = 0.5 * 10.0 ** -len(number.partition(".")[2])
        off = (float(number) - value) / half  # half of a place goes up
        assert math.isnan(value) or -0.9999 < off < 1.0001, (number, value)


@pytest.mark.parametrize("page", sorted({page for page, _, _ in ROWS}))
def test_each_row_of_what_fails_has_its_sources(page: str) -> None:
    _, heading, section = (DOCS / page).read_text(encoding="utf-8").lower().partition("when it fails\n")
    assert heading
    rows = [line for line in section.partition("\n## ")[0].splitlines() if line.startswith("|")]
    heads = [k for k, line in enumerate(rows) if set(line) <= set("|- ")]
    known = tuple(row.lower() for where, row, _ in ROWS if where == page)
    for k, line in enumerate(rows):
        assert k in heads or k + 1 in heads or line.startswith(known), f"{page}: no source of {line}"


def share_of_a_core(part: str, before: str) -> tuple[str, str, Numbers]:
    """Return the row of a part of a live run; `before`: cells of the table before that of the part."""
    sources: Numbers = [Source(SPEED, f"| {rate} Hz {before}| #% |") for rate in (100, 1000)]
    return "performance.md", f"| {part} | * | # % | # % |", sources


def hour_replayed(recording: str, first: int) -> tuple[str, str, Numbers]:
    """Return the row of the seconds of an hour; `first`: the first of two numbers of `SPEEDS`."""
    of = Source(SPEED, SPEEDS, lambda found: [3600.0 / one for one in found[0][first : first + 2]])
    return "performance.md", f"| {recording} | # s | # s |", [of]


SENTENCES: list[tuple[str, str, Numbers]] = [
    (
        "attitude.md",
        "the heading of the same filter is off by #° in one",
        [Source(ATTITUDE, f"| 02 undisturbed slow rotation B |{' * |' * 4} # |")],
    ),
    (
        "attitude.md",
        "and by #° in another",
        [Source(ATTITUDE, f"| 08 undisturbed fast rotation with breaks A |{' * |' * 4} # |")],
    ),
    (
        "attitude.md",
        "that accelerates straight ahead for # s or more",
        [Source(ATTITUDE_DETAILS, "--part straight`): error over σ 1.7 after # s")],
    ),
    (
        "attitude.md",
        "counts as error: #° in a tilt by #°",
        [Source(ATTITUDE_DETAILS, "| 22 | motion | 30.0 | * | * | * | * | no | # |"), 30],
    ),
    (
        "attitude.md",
        "A quick tilt that is taken back after # s, as in step 2, decides from #° on; one that is not taken"
        " back, from #° on",
        [TAU_ACC_S, *(math.degrees(math.sqrt(k * CONFIRMING_TURN)) for k in (1.0, 2.0))],
    ),
    ("attitude.md", "at least # % of the field: #°", [100.0 * IRON, math.degrees(IRON * 50.0 / 20.0)]),
    (
        "smoothing.md",
        "the error of the bias of y from # to # °/h rms",
        [Source(SMOOTHING, "| warm-up, handled, rests of 10 s, 15 min | *, #, * | *, #, * |")],
    ),
    (
        "smoothing.md",
        "f = # ± # °/h and b = # ± # °/h give x = # ± # °/h",
        [20, 10, 10, 5, (20.0 * 25.0 + 10.0 * 100.0) / 125.0, math.sqrt(100.0 * 25.0 / 125.0)],
    ),
    ("smoothing.md", "min(r, median(ρ) / #)); # is the median", [MEDIAN, MEDIAN]),
    (
        "smoothing.md",
        "up to # for two rests, # for twenty",
        [1.0 + math.sqrt(2.0 / 2.0), 1.0 + math.sqrt(2.0 / 20.0)],
    ),
    (
        "smoothing.md",
        "r of the bias is # to #.",
        [Source(SMOOTHING, "| # | # to # |", lambda found: least_and_largest([one[1:] for one in found]))],
    ),
    (
        "smoothing.md",
        "σ is # to # times as wide as needed",
        [
            Source(
                "smoothing.md",
                "min | * | * | #, #, # |",
                lambda found: [1 / max(map(max, found)), 1 / min(map(min, found))],
            )
        ],
    ),
    (
        "temperature-rate.md",
        "a filter runs for each combination of # values of q and # *noise models*",
        [len(JERK_PSDS), len(CODE_MODELS) + len(MEAN_MODELS)],
    ),
    (
        "temperature-rate.md",
        "# models are for noise below a step: # sizes of white noise, and four",
        [len(CODE_MODELS), len(WHITE_SDS)],
    ),
    (
        "temperature-rate.md",
        "at # °C/h a step of # °C takes # min",
        [1, 0.0625, 0.0625 * 60.0],
    ),
    (
        "thermal-calibration.md",
        "wrong by # °/h at # °C outside)",
        [Source("appendix/thermal-calibration-results.md", "| tangent | * | * | # |"), 2],
    ),
    (
        "temperature-rate.md",
        "σ is at least # °C/h with a step of # °C, and # °C/h with #.",
        [3600.0 / math.sqrt(12.0) / RAMP_S, 1, 3600.0 * 0.0625 / math.sqrt(12.0) / RAMP_S, 0.0625],
    ),
    (
        "temperature-rate.md",
        "error/σ is # rms with this term, and # without. The # s",
        [
            Source(ABLATION, "| none | 1.00 | 1.00 (white 0.03 step, 5 °C/h) | # |"),
            Source(ABLATION, "| no ramp that may have begun | * | * | # |"),
            RAMP_S,
        ],
    ),
    (
        "temperature-rate.md",
        "from # to −# °C in # min and on to # °C in #,",
        [Source(RATE, "from # to −# °C in # min and on to # °C in #,")],
    ),
    (
        "allan.md",
        "Simulated records of # minutes at # Hz with N = 10⁻³ rad/√s (# °/√h)",
        [
            Source(ALLAN, "Simulated records of # minutes at # Hz, 150 seeds"),
            math.degrees(1e-3) * 60.0,
        ],
    ),
    (
        "allan.md",
        "was then printed in # % of records at most",
        [Source(ALLAN, "not in the noise were printed in # % of the records at most")],
    ),
    (
        "rest-detector.md",
        "P(turn) is 1/10 at # °/h, 1/4 at # °/h and ½ at # °/h",
        [turn_at(0.1), turn_at(0.25), turn_at(0.5)],
    ),
    (
        "rest-detector.md",
        "bias jumps by # °/h to # °/s about the vertical",
        [
            turn_at(0.5),
            math.degrees(RestParameters().largest_jump),
        ],
    ),
    (
        "rest-detector.md",
        "The error is # to # σ, until the # h are over",
        [
            *(math.sqrt(1.0 + 1.0 / odds_of_change(dph)) for dph in (turn_at(0.5), LARGEST_JUMP)),
            RestParameters().undecided_s / 3600.0,
        ],
    ),
    (
        "rest-detector.md",
        "a turn below # °/s (# °/h) is mostly called rest, and σ is then wide. Below # °/h",
        [turn_at(0.5) / 3600.0, turn_at(0.5), turn_at(0.1)],
    ),
    (
        "rest-detector.md",
        "A turn of # °/s that begins within # s is called rest for # % of its time at most",
        [0.5, 0.5, Source(FIELD, f"{QUICK_TURN.replace('0.05', '0.5')}| # % false |", largest)],
    ),
    (
        "rest-detector.md",
        "changes the rate by less than # °/h within # s, so P(turn) stays below 1/4",
        [turn_at(0.25), 2.0 * LAG_S],
    ),
    (
        "tczupt.md",
        "60 N/√t at best: # °/h after 10 s, # °/h after a minute",
        [Source(TCZUPT, "60 ARW/√t: # after 10 s, * after 30 s, # after 60 s")],
    ),
    (
        "appendix/tczupt-details.md",
        "with # °C the bias is off by # σ, with # °C by # σ",
        [Source(WARMING, '("learned", #, 0, False, #), ("learned", #, 0, False, #)')],
    ),
    (
        "tczupt.md",
        "`thermal` is off by [# to # instead of # °/h]",
        [
            Source(TCZUPT, "| lag 30 s | imumon thermal | # # # |", least_and_largest),
            Source(TCZUPT, "| none | imumon thermal | # # # |", lambda found: [sum(found[0]) / 3.0]),
        ],
    ),
    (
        "alignment.md",
        "by # µrad (#°) in a minute turns the mean of the gyros over that minute by up to #°",
        [200, math.degrees(200e-6), math.degrees(200e-6 / 60.0 / DEG_PER_H / LEVEL_RATE)],
    ),
    ("alignment.md", "At #° latitude the horizontal part is # °/h", [36, LEVEL_RATE]),
    (
        "alignment.md",
        "If your gyros have # ppm, they turn the heading at rest by #° at #° and by #° at #°, and sigma",
        [300, *(of for at in (36, 60) for of in (300e-6 * DEGREE / math.cos(math.radians(at)), at))],
    ),
    (
        "alignment.md",
        "by # °/h between the two positions of half a turn turns the heading by up to #° at #°",
        [1, 0.5 / LEVEL_RATE * DEGREE, 36],
    ),
    (
        "alignment.md",
        "accelerometers alone leaves [#°]",
        [math.degrees(750e-6 * math.tan(math.radians(36.0)))],
    ),
    (
        "alignment.md",
        "(navigation grade) makes #°, and one of # °/h #°",
        [math.degrees(0.0035 / LEVEL_RATE), 0.75, math.degrees(0.75 / LEVEL_RATE)],
    ),
    (
        "alignment.md",
        "The noise alone makes #° in 60 s and #° in 600 s",
        [math.degrees(1e-3 * math.sqrt(3600.0 / s) / LEVEL_RATE) for s in (60.0, 600.0)],
    ),
    (
        "alignment.md",
        "Of [# sites]",
        [Source(ALIGNMENT, "simulates # kinds of sites and")],
    ),
    (
        "alignment.md",
        "# have a heading at both times. The rms of z is below # in # (60 s) and in all # (600 s)",
        [
            Source(ALIGNMENT, "# of the 88 sites have a heading at 60 and at 600 s"),
            Source(ALIGNMENT, "| rms of error over sigma at most # | # | # |"),
        ],
    ),
    (
        METHOD,
        "where Ω cos L is # °/h, for N = # °/√h",
        [LEVEL_RATE, 0.001],
    ),
    (
        METHOD,
        "| noise | N / (√t Ω cos L), or more | #° | #° | #° |",
        [AFTER_60_S, AFTER_600_S, AFTER_600_S],
    ),
    (
        METHOD,
        "| gyros' bias, # °/h | σ_b / (Ω cos L) | #° | #° |",
        [0.0035, BY_BIAS, BY_BIAS],
    ),
    (
        METHOD,
        "| accelerometers' bias, # µg | σ_β tan L | #° | #° |",
        [25, BY_ACCEL, BY_ACCEL],
    ),
    (
        METHOD,
        "| gyros' scale at rest, # ppm, if declared | σ_E / cos L; after half a turn σ_E | #° | #° | #° |",
        [10, BY_SCALE, BY_SCALE, 10e-6 * DEGREE],
    ),
    (METHOD, "| half of Ω times # s | | | #° |", [10, BY_TURN / 2]),
    (METHOD, "in the turn, # ppm | half of σ_E times the angle | | | #° |", [10, 90 * 10e-6]),
    (
        METHOD,
        "the root of the sum of squares | | #° | #° | #° |",
        [
            math.hypot(AFTER_60_S, BY_BIAS, BY_ACCEL, BY_SCALE),
            math.hypot(AFTER_600_S, BY_BIAS, BY_ACCEL, BY_SCALE),
            math.hypot(AFTER_600_S, 10e-6 * DEGREE, BY_TURN / 2, 90 * 10e-6),
        ],
    ),
    (
        METHOD,
        "With the default of # ppm the scale in the turn makes #°, and σ is #°, as in the row",
        [300, 90 * 300e-6, math.hypot(AFTER_600_S, BY_TURN / 2, 90 * 300e-6)],
    ),
    (
        METHOD,
        "in the turn makes #°, and σ is #°, as in the row",
        [0.027, Source(SITES, f"| half a turn, biases of 2 °/h |{' * |' * 14} # |")],
    ),
    (METHOD, "# °/h make #° in 60 s", [36, 36 * 60 / 3600]),
    (METHOD, "# °/h make #° in 600 s", [2, 2 * 600 / 3600 / 2]),
    (
        METHOD,
        'angle: #° for "0.3° in 600 s, steadily", whose error is #°',
        [
            Source(SITES, f"| 0.3° in 600 s, steadily |{' * |' * 14} # |"),
            Source(SITES, f"| 0.3° in 600 s, steadily |{' * |' * 12} # |"),
        ],
    ),
    (
        METHOD,
        "# °/h of each, # times the median, still shows in the lengths: after 600 s the rms error is #°, and"
        " σ #°",
        [
            0.05,
            0.05 / median_bias(0.001),
            Source(SITES, f"| bias of 0.05 °/h, not declared |{' * |' * 12} # | * | # |"),
        ],
    ),
    (METHOD, "but at least # °/h (its value for N = # °/√h)", [median_bias(0.002), 0.002]),
    (METHOD, "| #, from 1/# to # times a median |", [len(LOG_SIZES), *2 * [math.exp(LOG_SIZES[-1])]]),
    (METHOD, "| # to # 000 times the median |", [WORSE.max(axis=1).min(), WORSE.max() / 1000.0]),
    (METHOD, "two or all) | # % | # % |", [100 * P_WORSE, 100 * P_WORSE_THAN_DECLARED]),
    (ALIGNMENT, "| Ω, L | the earth rate, # °/h, *It is # °/h at #° |", [EARTH_DPH, LEVEL_RATE, 36]),
    (
        ALIGNMENT,
        "(# s for # °/√h at #°), at the latest after # min of rest.",
        [3600.0 * (1e-3 * DEGREE / LEVEL_RATE / 0.05) ** 2, 0.001, 36, LONGEST_S / 60.0],
    ),
    (ALIGNMENT, "# min of rest in the last position end the command", [LONGEST_S / 60.0]),
    (
        ALIGNMENT,
        "the noise counts # times as much by 150° as by 180°, and # times by 90°.",
        [1.0 / math.sin(math.radians(0.5 * angle)) for angle in (150.0, 90.0)],
    ),
    (ALIGNMENT, "without `--seconds`: # min of rest, and no heading", [HOPELESS_S / 60.0]),
    (
        ALIGNMENT,
        "as one sigma: #° for # s and # s of calm",
        [BY_TURN, 8, 2],
    ),
    (ALIGNMENT, "σ ends at ½ Ω t, #° for a turn of # s", [BY_TURN / 2, 8]),
    (ALIGNMENT, "after half a turn σ ends at #°, higher", [90 * 300e-6]),
    (ALIGNMENT, "# % of half a turn is #°.", [1, 180 * 0.01]),
    (ALIGNMENT, "by half of it, #°", [90 * 0.01]),
    (
        ALIGNMENT,
        "in a test # s after a turn by #°, and # s after one by #°",
        [
            Source("../tests/estimation/alignment/test_turns.py", "[(5.0, #), (30.0, 91.0)]"),
            Source("../tests/estimation/alignment/test_turns.py", "[(#, 31.0), (30.0, 91.0)]"),
            Source("../tests/estimation/alignment/test_turns.py", "[(5.0, 31.0), (30.0, #)]"),
            Source("../tests/estimation/alignment/test_turns.py", "[(5.0, 31.0), (#, 91.0)]"),
        ],
    ),
    (
        ALIGNMENT,
        "With # °/h and half a turn the heading is #° off after 10 min, and σ is #°",
        [Source("../tests/estimation/alignment/test_creep.py", "SAME_DPH, OFF_DEG, SD_DEG = #, #, #")],
    ),
    (
        ALIGNMENT,
        "its error at 60 s is # times that of the better mean",
        [Source(SITES, f"| settling 200 µrad, 60 s |{' * |' * 7} # |")],
    ),
    (
        ALIGNMENT,
        "where an accelerometer jumps: at 60 s # times",
        [Source(SITES, f"| accelerometers that jump by 30 µg |{' * |' * 7} # |")],
    ),
    (
        ALIGNMENT,
        'In the row "swell" *: #° at 60 s, #° at 600 s',
        [Source(SITES, f"| swell, 1000 µrad at 14 and 15 s |{' * |' * 8} # |{' * |' * 5} # |")],
    ),
    (
        ALIGNMENT,
        "At #° # °/h turn the heading by #° and lengthen the rate by # %",
        [
            50,
            0.2,
            math.degrees(math.atan(0.2 / AT_50)),
            100.0 * (math.hypot(1.0, 0.2 / AT_50) - 1.0),
        ],
    ),
    (
        ALIGNMENT,
        "the same with # °/h, at 36° | the heading is turned by #° and the rate is # % longer. For some"
        " seconds a heading up to # σ off",
        [
            3,
            math.degrees(math.atan(3.0 / LEVEL_RATE)),
            100.0 * (math.hypot(1.0, 3.0 / LEVEL_RATE) - 1.0),
            Source(SITES, f"| bias of 3 °/h of the gyro that points east |{' * |' * 18} # |"),
        ],
    ),
    (ALIGNMENT, "not in σ: # ppm are #°", [300, 300e-6 * DEGREE / math.cos(math.radians(36.0))]),
    (
        ALIGNMENT,
        "default of # µg alone leaves #° at #°, #° at #° and #° at #°",
        [750, *(of for at in (36, 50, 60) for of in (750e-6 * math.tan(math.radians(at)) * DEGREE, at))],
    ),
    (ALIGNMENT, "in one position σ ends at #° (36°)", [750e-6 * TAN * DEGREE]),
    (
        ALIGNMENT,
        "at #° half a turn of # s (t = # s) pays if σ_b is above # °/h (# ppm declared for the scale) or "
        "# °/h (the default of # ppm)",
        [36, 8, 10, WORTH_A_TURN[0], 10, WORTH_A_TURN[1], 300],
    ),
    (
        ALIGNMENT,
        "whose latitude is above #°, north or south",
        [math.floor(math.degrees(math.atan(math.radians(0.05) / 750e-6)))],
    ),
    (
        ALIGNMENT,
        '"settling 2000 µrad": # σ at most',
        [Source(SITES, f"| settling 2000 µrad, 3000 s |{' * |' * 18} # |")],
    ),
    (
        ALIGNMENT,
        '"at 60°, any attitude": # σ at most',
        [Source(SITES, f"| at 60°, any attitude, settling 50 µrad, 60 s |{' * |' * 18} # |")],
    ),
    (
        ALIGNMENT,
        "before the turn, # σ off",
        [Source(SITES, f"| {TWO_CREEPS} |{' * |' * 18} # |")],
    ),
    (
        "random-error.md",
        "of the first minute, held, is # °/h off",
        [Source(RANDOM, "| hold 60 s | # | * | - |")],
    ),
    (
        "random-error.md",
        "# °/h of it turn the angle by #° in a minute",
        [10, 10.0 / 60.0],
    ),
    (
        "random-error.md",
        "equal within the scatter of the runs (# to # °/h)",
        [
            Source(RANDOM, "| exponential 200 s | * | # to * |"),
            Source(RANDOM, "| drift | * | * to # |"),
        ],
    ),
    (
        "thermal-calibration.md",
        "this would be the error at the rates of this recording: # °/h on x in the soak",
        [Source(SOAK, "30 s of lag # ")],
    ),
    (
        "thermal-calibration.md",
        "wanders about its curve by # to # °/h",
        [Source(SOAK, "residual # # # °/h;", least_and_largest)],
    ),
    share_of_a_core("monitor", ""),
    share_of_a_core("view process", "| *% "),
    share_of_a_core("both: imumon", "| *% | *% "),
    share_of_a_core("Rerun's viewer", "| *% | *% | *% "),
    hour_replayed("at rest", 0),
    hour_replayed("at rest, with `--latitude`, so with the search for north", 2),
    hour_replayed("handled, with rests of 10 s", 4),
    (
        "performance.md",
        "**A recording of an hour** at # Hz is processed in # s",
        [400, Source(SPEED, SPEEDS, lambda found: [3600.0 / found[0][1]])],
    ),
    (
        "performance.md",
        "all packets that came within # ms. A batch costs almost the same with # samples (# Hz) as with #",
        [1e3 * BATCH_S, 100.0 * BATCH_S, 100, 1000.0 * BATCH_S],
    ),
    (
        "performance.md",
        "is # ms old (median), counted from its arrival at the computer, and in # % of the "
        "readings at most # ms. Up to # ms",
        [
            Source(SPEED, "| 1000 Hz | *% | *% | *% | *% | # |"),
            99,
            Source(SPEED, "| 1000 Hz | *% | *% | *% | *% | * | # |"),
            1e3 * BATCH_S,
        ],
    ),
    (
        "performance.md",
        "takes # s of the # s. `imumon decode`",
        [
            Source(SPEED, "| path | * | # |", lambda found: [3.6 * found[0][0]]),
            Source(SPEED, SPEEDS, lambda found: [3600.0 / found[0][1]]),
        ],
    ),
    (
        "performance.md",
        "`allan` needs the rest detector: # s for an hour at # Hz. The curves of six channels then take # s",
        [
            Source(SPEED, "| RestAndBias | * | # |", lambda found: [3.6 * found[0][0]]),
            400,
            Source(SPEED, "| Allan analysis of an hour at 400 Hz, six channels, s | * | # |"),
        ],
    ),
    (
        "performance.md",
        "`--help` needs # s, and decoding a small file # s",
        [
            Source(SPEED, "| longest --help, CPU s | * | # |"),
            Source(SPEED, "| decode of a small file, CPU s | * | # |"),
        ],
    ),
    (
        "performance.md",
        "a packet takes # to # µs, by device. Live, decoding takes some # % of a core",
        [
            Source(SPEED, "| bno08x-rvc | 19 | 8 | # |", lambda found: [found[0][0] / 1e3]),
            Source(SPEED, "| motioncal | 142 | 13 | # |", lambda found: [found[0][0] / 1e3]),
            Source(SPEED_DETAILS, "0.26 ms a second are # % of a core"),
        ],
    ),
    (
        SPEED_DETAILS,
        "The packet of # bytes costs # µs",
        [58, Source(SPEED, "| 65536 | # |", lambda found: [found[0][0] / 1000.0])],
    ),
    (
        SPEED_DETAILS,
        "less than # % of a core, and 99 % of the samples in the viewer within # ms",
        [
            Source(SPEED, "| live at 1000 Hz, share of a core | ≤ # |", lambda found: [100.0 * found[0][0]]),
            Source(SPEED, "| live at 1000 Hz, age p99, s | ≤ # |", lambda found: [1000.0 * found[0][0]]),
        ],
    ),
    (
        SPEED_DETAILS,
        "take # ms per second of data at 100 Hz and # ms at 400 Hz: # µs and # µs a sample. The section "
        "`zupt` has # µs a sample",
        [
            Source(
                SPEED,
                "| RestAndBias | # | # |",
                lambda found: [*found[0], 10.0 * found[0][0], 2.5 * found[0][1]],
            ),
            Source(SPEED, "| stage, standard | # |"),
        ],
    ),
    (
        SPEED_DETAILS,
        "in compiled code, and takes # µs",
        [Source(SPEED, "| VQF with its bias, for comparison | # |")],
    ),
    (
        NIGHT,
        "consumer # to # °/√h, industrial #, high-end tactical #.",
        [
            Source("allan.md", "| consumer, as an MPU-6050 | # |"),
            Source("allan.md", "| consumer, as a BMI160 | # |"),
            Source("allan.md", "| industrial | # |"),
            Source("allan.md", "| high-end tactical, as a fibre-optic gyro | # |"),
        ],
    ),
    (
        NIGHT,
        "angle random walk # °/√h and bias instability # °/h on each gyro, velocity random walk # m/s/√h",
        [
            Source(CRS05, "arw_deg_per_sqrt_h: #"),
            Source(CRS05, "sd_deg_per_h: #, tau_s: 10}", lambda found: [TO_INSTABILITY * found[0][0]]),
            Source(CRS05, "vrw_m_per_s_per_sqrt_s: #e-3", lambda found: [0.06 * found[0][0]]),
        ],
    ),
    (
        NIGHT,
        "gets flat, at # B, here # × # = # °/h",
        [
            FLOOR_PER_INSTABILITY,
            FLOOR_PER_INSTABILITY,
            Source(NIGHT, "instability °/h #("),
            Source(NIGHT, "instability °/h #(", lambda found: [FLOOR_PER_INSTABILITY * found[0][0]]),
        ],
    ),
    (NIGHT, "only if its fitted value is more than # of its standard deviations from zero", [SHOWN]),
    (
        NIGHT,
        "White noise alone would be at # °/h at # s",
        [
            Source(NIGHT, "random walk °/√h #(", lambda found: [found[0][0] / math.sqrt(819.2 / 3600.0)]),
            819,
        ],
    ),
    (
        NIGHT,
        "| two hours | # ± # |",
        [Source(NIGHT, "instability °/h #(#)", lambda found: [found[0][0], 0.01 * found[0][1]])],
    ),
    (
        NIGHT,
        "| `gyroscope_random_walk` | z: # °/h = #e-6 rad/s at # s | #e-7 (rad/s/√s) |",
        [
            Source(NIGHT, LOWEST_OF_GYROS, lambda found: largest_walk(found[0], DEG_PER_H, 2, (1e6, 1e7))),
        ],
    ),
    (
        NIGHT,
        "| `accelerometer_random_walk` | x: # µg = #e-5 m/s² at # s | #e-6 (m/s²/√s) |",
        [
            Source(NIGHT, LOWEST_OF_ACCELS, lambda found: largest_walk(found[0], MICRO_G, 0, (1e5, 1e6))),
        ],
    ),
    (
        NIGHT,
        "(1 °/h is #e-6 rad/s, 1 µg is #e-6 m/s².)",
        [1e6 * DEG_PER_H, 1e6 * MICRO_G],
    ),
    (
        PUBLISHED,
        "k = # 1/s and k_b = # rad/m, make one of √(k_b g) / 2π = # Hz with a damping of # |",
        [3.5, 0.8, PRINTED / (2.0 * math.pi), 3.5 / (2.0 * PRINTED)],
    ),
    (
        PUBLISHED,
        "as the text: k = # 1/s, k_b = # rad/m",
        [2.0 * DAMPING * CORNER, CORNER**2 / STANDARD_GRAVITY],
    ),
    (
        PUBLISHED,
        "| random walk of the bias | # °/h/√s, so # °/h in an hour |",
        [DENSE.bias_random_walk / DEG_PER_H, DENSE.bias_random_walk / DEG_PER_H * math.sqrt(3600.0)],
    ),
    (PUBLISHED, "| first bias of the gyros, σ | # °/h |", [DENSE.bias_sd / DEG_PER_H]),
    (
        "published.md",
        "(if absent #, as in the paper), `window_s` (#), `time_constant_s` (#), `buffer_size` (# changes",
        [
            DEFAULT_STEP_DEGC,
            *(
                getattr(TemperatureRateParameters(), key)
                for key in ("window_s", "time_constant_s", "buffer_size")
            ),
        ],
    ),
    (
        "published.md",
        "| # °/h | `sr_ukf` #, `sr_rsukf` # °/h, with their best parameters; `stf` # °/h",
        [
            Source("random-error.md", "| the default, without declared noise | # |"),
            Source("random-error.md", "| SR-UKF, with its best parameter | # |"),
            Source("random-error.md", "| SR-RSUKF, with its best parameters | # |"),
            Source("random-error.md", "| STF: it follows nearly every reading | # |"),
        ],
    ),
    (
        "published.md",
        "an exponential mean of # s has # °/h; the mean of the first minute, held, has # °/h. So imumon, the "
        "two unscented filters and the exponential mean are equal within the scatter, # to # °/h",
        [
            Source("random-error.md", "| exponential mean, # s | # |"),
            Source("random-error.md", "| mean of the first minute, held | # |"),
            Source("random-error.md", "equal within the scatter of the runs (# to # °/h)"),
        ],
    ),
    (
        "published.md",
        "| #, #, # °/h | the filter of `dense_*` with the curve as in `dense_zupt` #, #, # °/h;",
        [
            Source(TCZUPT, "| none | imumon thermal | # # # |"),
            Source(TCZUPT, "| none | increments of the reading (0.05 degC steps) | # # # |"),
        ],
    ),
    (
        "published.md",
        "and the rate by `fir` #, #, # °/h",
        [Source(TCZUPT, "| none | slope x FIR rate | # # # |")],
    ),
    (
        "published.md",
        "at a latitude of #° a bias of 1 °/h towards east turns the heading by #°",
        [36.0, math.degrees(math.atan(1.0 / LEVEL_RATE))],
    ),
]
"""Page, a sentence with # for its numbers, and what these are."""


@pytest.mark.parametrize(("page", "sentence", "sources"), SENTENCES)
def test_numbers_of_a_sentence_are_those_of_its_sources(page: str, sentence: str, sources: Numbers) -> None:
    (shown,) = shaped(page, sentence)
    compare(shown, sources)


@pytest.mark.long
def test_errors_of_the_temperature_rate_beside_the_published_filter() -> None:
    rate = r"([\d.]+) °C/h; error/σ ([\d.]+)"
    pattern = rf"\| {rate}: σ is .* \| `fir` {rate}: its"
    step, time_ns, reading, truth = heated_unit()
    begun = slice(int(np.searchsorted(time_ns, 300 * 10**9)), None)
    measured = []
    for method in (MultipleModelRate(), FirRate(Params(step, 300.0, 180.0, 1000))):
        _, found, _, sd = method.process(time_ns, np.zeros(len(time_ns), np.int64), reading)
        error = (found - truth)[begun]
        measured += [3600.0 * math.sqrt(np.mean(error**2)), math.sqrt(np.mean((error / sd[begun]) ** 2))]
    assert numbers_in("published.md", pattern) == pytest.approx(measured, rel=0.03)


def mean_of_cut(bias: float, noise: float) -> float:
    """Return the mean of noisy readings that are cut toward zero to whole numbers."""
    steps, of = np.arange(1.0, bias + 10.0 * noise + 2.0), math.sqrt(2.0) * noise
    above = sum(math.erfc((step - bias) / of) for step in steps)
    return 0.5 * (above - sum(math.erfc((step + bias) / of) for step in steps))


def test_errors_of_rates_that_are_cut_toward_zero() -> None:
    (table,) = (each for each in tables("devices-others.md") if each[0][1] == "noise of half a step")
    for row in table[1:]:
        steps, *shown = map(float, numbers(row))
        assert shown[0] == round(steps / DEG_PER_H * 1e-3)
        errors = [(steps - mean_of_cut(steps, noise)) / DEG_PER_H * 1e-3 for noise in (0.5, 1.0, 3.0)]
        assert shown[1:] == pytest.approx(errors, abs=0.5)


def test_counts_of_the_attitude_page() -> None:
    *simulated, measured = tables(ATTITUDE)
    rows = [[float(row[k]) for k in (6, 7, 12, 13)] for table in simulated for row in table[1:]]
    good = [row for row in rows if max(row[0], row[2]) <= 1.5]
    pattern = r"Of \[(\d+) simulated rows\].* none, (\d+) have an error over σ of at most ([\d.]+) rms"
    assert numbers_in("attitude.md", pattern) == [len(rows), len(good), 1.5]
    most = max(max(row[1], row[3]) for row in good)
    pattern = r"Single moments reach ([\d.]+): .* The other (\d+) are of"
    assert numbers_in("attitude.md", pattern) == [most, len(rows) - len(good)]
    others = {row[0] for table in simulated for row in table[1:] if max(float(row[6]), float(row[12])) > 1.5}
    kinds = "consumer accelerometers", "gyro z reversed", "magnet on the body"
    assert all(any(kind in name for name in others) for kind in kinds)
    assert all(any(kind in name for kind in kinds) for name in others)
    most = max(float(row[k]) for row in measured[1:] for k in (3, 7))
    assert numbers_in("attitude.md", r"all within ([\d.]+) σ") == [most]
    assert len(measured[1:]) == 4  # "two of four trials"


def test_what_a_packet_costs() -> None:
    cost = {row[0]: [float(row[k]) for k in (1, 4)] for row in tables(SPEED)[1][1:]}
    packets = 1024 / 58
    feed = (cost["1024"][0] - cost["65536"][0]) * packets / 1000.0
    take = (cost["1024"][1] - cost["1024"][0]) * packets / 1000.0
    times = [cost["1024"][k] / cost["65536"][k] for k in (0, 1)]
    sentence = "`feed` adds about # µs, each `take` about # µs"
    compare(shaped(SPEED_DETAILS, sentence)[0], [feed, take])
    sentence = "costs # times as much per packet as in 64 KiB chunks, and a `take` after each of them # times"
    compare(shaped(SPEED_DETAILS, sentence)[0], [*times])
    live = "takes every # ms: # times # ms a second are # % of a core, at any rate. The packets add # % at"
    takes, share = 1.0 / BATCH_S, 100.0 * cost["65536"][0] * 1e-7
    compare(shaped(SPEED_DETAILS, live)[0], [1e3 * BATCH_S, takes, take / 1e3, takes * take * 1e-4, share])


def test_missed_limits_are_those_of_the_table() -> None:
    missed = [row[0] for row in tables(SPEED)[-1] if row[-1] == "FAIL"]
    (shown,) = (table for table in tables(SPEED_DETAILS) if table[0][0] == "limit")
    assert [row[0] for row in shown[1:]] == missed
