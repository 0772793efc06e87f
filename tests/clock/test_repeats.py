"""Counters and clocks that stand, and packets that come twice."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import NO_INT, IntArray
from imumon.clock.checks import STANDS, Repeats
from imumon.clock.device import DatedBy

N = 3 * STANDS


def said(
    counter: IntArray | None, ticks: IntArray | None, size: int = N, dated_by: DatedBy = "clock"
) -> list[str]:
    repeats = Repeats()
    for start in range(0, N, size):
        part = slice(start, min(start + size, N))
        repeats.add(
            None if counter is None else counter[part],
            None if ticks is None else ticks[part],
            part.stop - start,
        )
    texts = repeats.notices(dated_by)
    assert repeats.notices(dated_by) == []
    return texts


GOES_ON = np.arange(N)
STAYS = np.full(N, 7)


@pytest.mark.parametrize("size", [1, 7, STANDS, N])
def test_what_stands_is_reported_once_with_what_it_means(size: int) -> None:
    (text,) = said(STAYS, GOES_ON, size)
    assert text == "the packet counter stands at 7: it does not show packets that are lost"
    (text,) = said(STAYS, None, size, "counter")
    assert text.startswith("the packet counter stands at 7")
    assert "their rows have one time" in text
    for counter in (GOES_ON, None):
        (text,) = said(counter, STAYS, size)
        assert text.startswith("the device's clock stands at its count 7: their rows have one time")


@pytest.mark.parametrize("size", [1, 7, N])
@pytest.mark.parametrize("each", [1, 2, 10])
def test_packets_that_come_twice_are_counted(size: int, each: int) -> None:
    twice = np.sort(np.concatenate([np.arange(0, N, each)[: N // 2], np.arange(N)]))[:N]
    (text,) = said(twice, 100 * twice, size)
    assert text.startswith(f"{N - len(np.unique(twice))} of {N} rows have the counter and the time")


@pytest.mark.parametrize("size", [1, 7, N])
def test_what_goes_on_is_not_reported(size: int) -> None:
    missing = np.full(N, NO_INT)
    assert said(GOES_ON, GOES_ON, size) == said(GOES_ON % 16, GOES_ON, size) == []
    assert said(None, None, size) == said(missing, missing, size) == said(missing, GOES_ON, size) == []
    # A clock that ticks once in 80 packets, a counter that stays for shorter than that.
    assert said(GOES_ON, GOES_ON // 80, size) == said(GOES_ON // 80, GOES_ON, size) == []
    assert said(None, GOES_ON // 80, size) == []
