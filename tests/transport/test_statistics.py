from __future__ import annotations

import pytest

from imumon.transport.settings import PortSettings
from imumon.transport.statistics import LinkStatistics

SECOND = 1_000_000_000
LINE = PortSettings("/dev/ttyUSB0", 100_000)  # carries 10 000 bytes/s


def stream(
    statistics: LinkStatistics, bytes_per_s: int, start_s: float, stop_s: float, every_ms: int = 10
) -> int:
    """Feed a steady stream; return the time of its end in ns."""
    times = range(int(start_s * 1000), int(stop_s * 1000), every_ms)
    for time_ms in times:
        statistics.add(bytes_per_s * every_ms // 1000, time_ms * 1_000_000)
    return int(stop_s * SECOND)


def test_nothing_received_is_no_rate_and_no_load() -> None:
    statistics = LinkStatistics(LINE)
    assert statistics.bytes_per_s(5 * SECOND) == 0.0
    assert statistics.load(5 * SECOND) == 0.0
    assert not statistics.overloaded(5 * SECOND)


@pytest.mark.parametrize("seconds", [0.5, 1.0, 7.0])
def test_a_steady_stream_has_its_rate_soon_and_late(seconds: float) -> None:
    statistics = LinkStatistics(LINE)
    now = stream(statistics, 5000, 0.0, seconds)
    assert statistics.bytes_per_s(now) == pytest.approx(5000)
    assert statistics.load(now) == pytest.approx(0.5)


def test_the_rate_decays_to_zero_when_the_device_goes_silent() -> None:
    statistics = LinkStatistics(LINE)
    now = stream(statistics, 5000, 0.0, 4.0)
    assert statistics.bytes_per_s(now + SECOND) == pytest.approx(2500)
    assert statistics.bytes_per_s(now + 3 * SECOND) == 0.0


def test_parity_and_stop_bits_load_the_line() -> None:
    statistics = LinkStatistics(PortSettings("/dev/ttyUSB0", 100_000, parity="E", stopbits=2))
    now = stream(statistics, 5000, 0.0, 4.0)
    assert statistics.load(now) == pytest.approx(0.6)


def test_the_warning_comes_above_80_percent_and_goes_below_70() -> None:
    statistics = LinkStatistics(LINE)
    steps = [(7900, False), (8100, True), (7500, True), (6900, False), (7500, False)]
    seen = []
    for index, (rate, _) in enumerate(steps):
        now = stream(statistics, rate, 4.0 * index, 4.0 * index + 4.0)
        seen.append(statistics.overloaded(now))
    assert seen == [warned for _, warned in steps]


def test_a_network_stream_has_a_rate_but_no_load() -> None:
    statistics = LinkStatistics(PortSettings("socket://host:4000"))
    now = stream(statistics, 9_000_000, 0.0, 2.0)
    assert statistics.bytes_per_s(now) == pytest.approx(9_000_000)
    assert statistics.load(now) is None
    assert not statistics.overloaded(now)


def test_a_backlog_at_the_start_is_no_overload() -> None:
    statistics = LinkStatistics(PortSettings("/dev/ttyUSB0", 115200))
    statistics.add(4000, 0)
    for tick in range(1, 60):
        statistics.add(576, tick * 100_000_000)
        assert not statistics.overloaded(tick * 100_000_000)


def late(arrivals_ms: range, stalls_s: list[tuple[float, float]]) -> list[int]:
    """Return the times at which reads end that cannot happen during the stalls (begin and end, s), ms."""
    ends = []
    for time_ms in arrivals_ms:
        stall = next((stop for start, stop in stalls_s if start <= time_ms / 1000 < stop), None)
        ends.append(time_ms if stall is None else int(stall * 1000))
    return ends


@pytest.mark.parametrize(
    "stalls_s", [[(10.0, 10.9)], [(10.0, 14.0)], [(10.0, 50.0)], [(10.0, 14.0), (14.3, 15.9)], [(0.0, 9.0)]]
)
def test_a_read_that_comes_late_is_no_load(stalls_s: list[tuple[float, float]]) -> None:
    statistics = LinkStatistics(LINE)
    loads = []
    for number, time_ms in enumerate(late(range(0, 90_000, 10), stalls_s)):
        statistics.add(50, time_ms * 1_000_000)
        if number % 10 == 0:
            loads.append(statistics.load(time_ms * 1_000_000))
            assert not statistics.overloaded(time_ms * 1_000_000)
    assert max(load or 0.0 for load in loads) < 0.6
    assert loads[-1] == pytest.approx(0.5)


@pytest.mark.parametrize("bytes_per_s", [9000, 11_500])
def test_a_line_that_is_full_is_reported_on_a_busy_computer_too(bytes_per_s: int) -> None:
    statistics = LinkStatistics(LINE)
    warned = False
    for time_ms in late(range(0, 30_000, 10), [(10.0, 11.0), (20.0, 20.4)]):
        statistics.add(bytes_per_s // 100, time_ms * 1_000_000)
        warned |= statistics.overloaded(time_ms * 1_000_000)
    assert warned
