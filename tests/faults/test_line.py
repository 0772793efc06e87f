from __future__ import annotations

from pathlib import Path

import pytest

from tests.faults.line import steal, strike_all
from tests.waiting import LIMIT_S

BRIEF = [
    "bits flipped in every third packet",
    "junk before every packet",
    "packets sent twice, in pairs",
    "packets of a burst of 5 shuffled",
    "cable pulled in a packet",
    "device reboots in a packet",
    "device clock leaps a minute back",
    "host clock leaps an hour back",
]


@pytest.mark.long
@pytest.mark.usefixtures("no_leaks")
def test_a_line_that_fails_costs_what_it_touched_and_is_reported(tmp_path: Path) -> None:
    wrong = {name: o.wrong for name, o in strike_all(tmp_path, BRIEF, 1, 0.5, LIMIT_S) if o.wrong}
    assert not wrong


@pytest.mark.long
def test_what_another_process_takes_is_missing_and_reported(tmp_path: Path) -> None:
    assert not steal(tmp_path, 1, 0.5, LIMIT_S).wrong
