"""The log as a text that wraps."""

from __future__ import annotations

from imumon.view.items import Instant, Log
from imumon.view.lanes import LINES, LogText


def test_the_newest_line_stands_first_with_its_time_and_its_level() -> None:
    text = LogText()
    text.add(Log(Instant(None, None, 1_700_000_000_000_000_000), "port opened"))
    text.add(Log(Instant(None, None, None), "too *hot* | <b>", "WARN"))
    first, second = text.text.split("\n\n")
    assert first == r"`--:--:--` **WARN** too \*hot\* \| \<b\>"
    assert second.endswith("port opened")
    assert second[3] == ":"


def test_memory_is_bounded_and_a_damaged_time_is_no_crash() -> None:
    text = LogText()
    for number in range(100):
        text.add(Log(Instant(None, None, 2**63 - 1), str(number)))
    assert text.text.count("`") == 2 * LINES
