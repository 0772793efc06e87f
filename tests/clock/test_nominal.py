"""A nominal rate against the times of arrival."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import NO_INT, IntArray
from imumon.clock import DeviceClock
from imumon.clock.checks import NominalRate
from imumon.protocols.base import Timing

NOMINAL_HZ, SECONDS = 50.0, 40.0


def arrivals(rate_hz: float) -> IntArray:
    """Return times of arrival in bursts of 16 ms, as of a USB adapter."""
    t = np.arange(round(SECONDS * rate_hz)) / rate_hz
    late = np.ceil((t + np.random.default_rng(0).exponential(0.002, len(t))) / 0.016) * 0.016
    return np.asarray((np.maximum.accumulate(late) * 1e9).astype(np.int64) + 10**18)


def watched(arrival_ns: IntArray, counted: bool, given: bool = False, size: int = 37) -> NominalRate:
    clock = DeviceClock(Timing(counter_bits=16 if counted else None, rate_hz=NOMINAL_HZ))
    watch = NominalRate(NOMINAL_HZ, given)
    for start in range(0, len(arrival_ns), size):
        part = arrival_ns[start : start + size]
        counter = (start + np.arange(len(part))) % 65536 if counted else None
        watch.add(*clock.process(counter, None, part, len(part)), part)
    assert clock.dated_by == ("counter" if counted else "rows")
    return watch


@pytest.mark.parametrize("rate_hz", [5.0, 46.0, 54.0, 500.0])
@pytest.mark.parametrize("counted", [False, True])
def test_another_rate_is_reported_once_and_measured(rate_hz: float, counted: bool) -> None:
    watch = watched(arrivals(rate_hz), counted)
    assert watch.measured_hz == pytest.approx(rate_hz, rel=2e-3)
    (text,) = watch.notices(ended=False)
    assert f"nominal 50 Hz, but they arrive at {rate_hz:g} Hz" in text
    assert watch.notices(ended=True) == []


@pytest.mark.parametrize("rate_hz", [48.5, 50.0, 51.5])
def test_what_a_sensor_clock_may_be_off_is_not_reported(rate_hz: float) -> None:
    assert watched(arrivals(rate_hz), counted=False).notices(ended=True) == []


def test_without_times_of_arrival_the_rate_is_an_assumption_unless_it_was_given() -> None:
    unknown = np.full(500, NO_INT)
    watch = watched(unknown, counted=False)
    assert watch.notices(ended=False) == []
    (text,) = watch.notices(ended=True)
    assert "nominal 50 Hz, and nothing shows" in text
    assert watched(unknown, counted=False, given=True).notices(ended=True) == []


def test_a_silence_is_no_low_rate() -> None:
    arrival_ns = arrivals(NOMINAL_HZ)
    arrival_ns[len(arrival_ns) // 2 :] += 60_000_000_000
    watch = watched(arrival_ns, counted=False)
    assert watch.measured_hz == pytest.approx(NOMINAL_HZ, rel=2e-3)


@pytest.mark.parametrize("stalls_s", [[(0.0, 8.0)], [(5.0, 12.0)], [(0.5, 2.5)], [(6.0, 8.9), (12.0, 14.5)]])
@pytest.mark.parametrize("rate_hz", [NOMINAL_HZ, 40.0])
def test_a_burst_of_late_reads_is_no_other_rate(stalls_s: list[tuple[float, float]], rate_hz: float) -> None:
    sent_s = np.arange(round(60 * rate_hz)) / rate_hz
    arrived_s = sent_s.copy()
    for start, stop in stalls_s:
        arrived_s[(sent_s >= start) & (sent_s < stop)] = stop
    clock, watch = DeviceClock(Timing(rate_hz=NOMINAL_HZ)), NominalRate(NOMINAL_HZ, False)
    notices = list[str]()
    for part in np.split((arrived_s * 1e9).astype(np.int64) + 10**18, np.arange(10, len(sent_s), 10)):
        watch.add(*clock.process(None, None, part, len(part)), part)
        notices += watch.notices(ended=False)
    if rate_hz == NOMINAL_HZ:
        assert notices == []
    else:
        assert len(notices) == 1
        found = float(notices[0].partition("arrive at ")[2].split()[0])
        assert found == pytest.approx(rate_hz, rel=0.1)
