from __future__ import annotations

import math

from imumon.fleet.rack.feed import Vitals
from imumon.fleet.rack.table import HEADINGS, bias, in_short, markdown, row_of, text_lines
from imumon.geodesy import DEG_PER_H

RESTING = Vitals(
    session="sessions/x",
    lanes={"port": "open", "model": "OK"},
    temperature_deg=24.567,
    bias=(12.345 * DEG_PER_H, -3.2 * DEG_PER_H, 0.01 * DEG_PER_H),
    bias_sd=(0.1 * DEG_PER_H, 0.234 * DEG_PER_H, 0.05 * DEG_PER_H),
    packets_per_s=399.6,
    packets_lost=1234,
    bytes_received=23_200_000,
    cpu=0.052,
    memory_mb=121.4,
)


def test_a_bias_has_the_digits_of_its_largest_sigma() -> None:
    assert bias(RESTING) == "12.35 -3.20 0.01 ± 0.23"
    assert bias(Vitals(bias=(1.0, 2.0, 3.0), bias_sd=(0.01, 0.01, 0.02))) == "206300 412500 618800 ± 4100"
    assert bias(Vitals()) == "–"


def test_what_is_not_known_is_a_dash() -> None:
    row = row_of("a", "starting", Vitals(), 0)
    assert row == ("a", "starting", "–", "–", "–", "0", "0", "0.0 MB", "0%", "–", "0")
    assert math.isnan(Vitals().memory_mb)


def test_terminal_and_viewer_have_the_same_cells() -> None:
    rows = [row_of("left", "rest", RESTING, 0), row_of("a|b", "DEAD (-9)", Vitals(), 3)]
    head, first, second = text_lines(rows)
    assert head.split("  ")[0] == "unit"
    assert first.split() == [
        *["left", "rest", "24.57", "12.35", "-3.20", "0.01", "±", "0.23", "OK"],
        *["400", "1,234", "23.2", "MB", "5%", "121", "0"],
    ]
    assert second.startswith("a|b   DEAD (-9)")
    lines = markdown(rows).splitlines()
    assert lines[0] == f"| {' | '.join(HEADINGS)} |"
    assert len(lines) == 4
    assert lines[3].startswith("| a\\|b | DEAD (-9) |")
    assert in_short([*rows, rows[0]]) == "3 units: 2 rest, 1 DEAD (-9)"
