"""The clocks against simulated truth: accuracy, wraps, restarts, gaps, stalls, and independence of blocks."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np
import numpy.typing as npt
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import linprog

from imumon.blocks import NO_INT, FloatArray, IntArray
from imumon.clock import DeviceClock, HostClock
from imumon.clock.host import BLOCK_NS, BLOCKS, MARGIN, PRIOR, TOUCH, _line
from imumon.errors import ImumonError, Reason
from imumon.protocols.base import Timing

RealArray = npt.NDArray[np.floating[Any]]

MS, S = 10**6, 10**9
EPOCH = 1_760_000_000 * S
LATENCY = 300_000
"""Least delay in the simulations, ns: no method can see it, so errors are relative to it."""
MICROSECONDS = Timing(counter_bits=8, tick_ns=Fraction(1000), tick_bits=32, rate_hz=100.0)
COUNTER_ONLY = Timing(counter_bits=8, rate_hz=100.0)


def offset_ns(clock: HostClock, device_ns: int) -> int:
    """Return host time minus device time, by the line."""
    return int(clock._fit.y0) + _line(clock._fit, device_ns - int(clock._fit.x0))


def usb_arrivals(truth_ns: RealArray, burst_ns: float, rng: np.random.Generator) -> IntArray:
    """Return arrivals through an adapter whose latency timer starts again after each transfer.

    The host adds a delay with an exponential tail (0.3 ms) to each transfer, and now and then stalls.
    """
    span = float(truth_ns[-1] - truth_ns[0])
    transfers = int(span / burst_ns) + 100
    sent = (
        float(truth_ns[0])
        - burst_ns * rng.random()
        + np.cumsum(burst_ns + rng.exponential(20_000.0, transfers))
    )
    delay = rng.exponential(300_000.0, transfers)
    delay += (rng.random(transfers) < 1e-3) * rng.exponential(30e6, transfers)
    transfer = np.searchsorted(sent, truth_ns + LATENCY)
    return EPOCH + np.maximum.accumulate(sent + delay)[transfer].astype(np.int64)


def device_times(rate_hz: float, duration_s: float) -> IntArray:
    return (np.arange(int(rate_hz * duration_s)) * (S / rate_hz)).astype(np.int64)


def fit(device_ns: IntArray, arrival_ns: IntArray, segment: IntArray | None = None) -> IntArray:
    return HostClock().process(
        device_ns, np.zeros_like(device_ns) if segment is None else segment, arrival_ns
    )


def error_ms(host_ns: IntArray, truth_ns: RealArray) -> FloatArray:
    return np.asarray((host_ns - EPOCH) - (truth_ns + LATENCY)) / MS


def p99(error: FloatArray) -> float:
    return float(np.percentile(np.abs(error), 99))


class TestHostClock:
    @pytest.mark.parametrize("rate_hz", [100.0, 400.0])
    @pytest.mark.parametrize("drift_ppm", [-50.0, 0.0, 50.0, 200.0])
    @pytest.mark.parametrize("burst_ms", [1.0, 16.0])
    def test_after_a_minute_99_percent_are_within_a_millisecond(
        self, rate_hz: float, drift_ppm: float, burst_ms: float
    ) -> None:
        device = device_times(rate_hz, 300.0)
        truth = device * (1.0 + drift_ppm * 1e-6)
        for seed in range(3):
            arrival = usb_arrivals(truth, burst_ms * MS, np.random.default_rng(seed))
            host = fit(device + 7 * S, arrival)
            assert np.all(host <= arrival)
            assert np.all(np.diff(host) >= 0)
            error = error_ms(host, truth)
            assert p99(error[device >= 60 * S]) < 0.5
            assert p99(error[device < 5 * S]) < burst_ms

    @pytest.mark.parametrize(("rate_hz", "bound_ms"), [(100.0, 1.1), (200.0, 0.6), (400.0, 0.1)])
    def test_a_strict_beat_of_sampling_and_polling_is_bridged(self, rate_hz: float, bound_ms: float) -> None:
        # 10 ms samples and 16 ms polls meet every 2 ms only; at 50 ppm that pattern moves on in 40 s.
        device = device_times(rate_hz, 300.0)
        for drift_ppm in (-50.0, 50.0):
            for phase_ms in (0.0, 0.4, 0.8, 1.2, 1.6):
                truth = device * (1.0 + drift_ppm * 1e-6) + phase_ms * MS
                arrival = EPOCH + (np.ceil((truth + LATENCY) / (16 * MS)) * 16 * MS).astype(np.int64)
                error = error_ms(fit(device, arrival), truth)
                assert p99(error[device >= 60 * S]) < bound_ms

    @pytest.mark.parametrize("poll_ms", [0.0, 1.0, 16.0, 50.0])
    def test_the_drift_has_a_sigma_that_holds_once_it_is_known_and_none_before(self, poll_ms: float) -> None:
        rng = np.random.default_rng(11)
        errors = []
        for _ in range(12):
            device = np.arange(12_000, dtype=np.int64) * 10 * MS
            drift_ppm = rng.normal(0.0, 50.0)
            truth = device * (1.0 + drift_ppm * 1e-6)
            phase = rng.uniform(0.0, poll_ms) * MS
            polled = np.ceil((truth - phase) / (poll_ms * MS)) * poll_ms * MS + phase if poll_ms else truth
            arrival = np.maximum.accumulate(polled + rng.exponential(0.3 * MS, len(truth))).astype(np.int64)
            clock = HostClock()
            clock.process(device[:800], np.zeros(800, np.int64), arrival[:800])
            assert np.isnan(clock.drift_sd_ppm), "8 s"
            clock.process(device[800:], np.zeros(len(device) - 800, np.int64), arrival[800:])
            errors.append((clock.drift_ppm - drift_ppm) / clock.drift_sd_ppm)
        assert np.sqrt(np.mean(np.square(errors))) < 1.6

    @pytest.mark.parametrize("drift_ppm", [-120.0, 35.0])
    def test_tells_drift_offset_and_delay(self, drift_ppm: float) -> None:
        device = device_times(100.0, 200.0)
        truth = device * (1.0 + drift_ppm * 1e-6)
        arrival = usb_arrivals(truth, 16.0 * MS, np.random.default_rng(1))
        clock = HostClock()
        assert clock.delay_ns is None
        host = clock.process(device, np.zeros_like(device), arrival)
        assert clock.drift_ppm == pytest.approx(drift_ppm, abs=2.0)
        assert offset_ns(clock, device[-1]) == pytest.approx(
            EPOCH + truth[-1] - device[-1] + LATENCY, abs=0.5 * MS
        )
        assert clock.delay_ns == arrival[-1] - host[-1]

    def test_is_exact_to_a_nanosecond_after_a_day(self) -> None:
        device = np.arange(0, 86_400 * S, S, dtype=np.int64)
        arrival = EPOCH + device + device // 20_000
        assert np.max(np.abs(fit(device, arrival) - arrival)) <= 1

    def test_agrees_with_linear_programming(self) -> None:
        rng = np.random.default_rng(5)
        device = np.sort(rng.integers(0, 900 * S, 600))
        arrival = EPOCH + device + device // 12_500 + rng.exponential(8e6, 600).astype(np.int64)
        clock = HostClock()
        for i in range(len(device)):
            clock.process(device[i : i + 1], np.zeros(1, np.int64), arrival[i : i + 1])
            if i % 40 == 39:
                slope, offset = fit_twin(device[: i + 1] - device[0], (arrival - device)[: i + 1] - EPOCH)
                assert clock.drift_ppm == pytest.approx(slope * 1e6, rel=1e-6, abs=1e-6)
                assert offset_ns(clock, device[i]) == pytest.approx(EPOCH + offset, abs=2.0)

    def test_goes_on_after_a_gap_as_if_there_was_none(self) -> None:
        device = device_times(100.0, 200.0)
        device = device[(device < 100 * S) | (device > 110 * S)]
        truth = device * (1.0 + 50e-6)
        arrival = usb_arrivals(truth, 16.0 * MS, np.random.default_rng(2))
        error = error_ms(fit(device, arrival), truth)
        assert p99(error[device > 60 * S]) < 0.5

    @pytest.mark.parametrize(("step_ns", "recovery_s"), [(-S, 2), (S, 12), (-3600 * S, 2), (3600 * S, 12)])
    def test_recovers_when_the_host_clock_is_set(self, step_ns: int, recovery_s: int) -> None:
        device = device_times(100.0, 240.0)
        truth = device * (1.0 - 30e-6)
        arrival = usb_arrivals(truth, 16.0 * MS, np.random.default_rng(3))
        after = device >= 100 * S
        arrival[after] += step_ns
        host = fit(device, arrival)
        assert np.all(host <= arrival)
        error = error_ms(host - step_ns * after, truth)
        assert p99(error[(device > (100 + recovery_s) * S)]) < 3.0
        assert p99(error[(device > 170 * S)]) < 0.5

    def test_follows_a_crystal_that_warms_up(self) -> None:
        device = device_times(100.0, 900.0)
        minutes = device / (60 * S)
        # 20 ppm in the first ten minutes, slowing down.
        drift_ns = 20e-6 * 60 * S * (minutes - 4.0 * (1.0 - np.exp(-minutes / 4.0)))
        for sign in (-1.0, 1.0):
            truth = device + sign * drift_ns
            arrival = usb_arrivals(truth, 16.0 * MS, np.random.default_rng(4))
            assert p99(error_ms(fit(device, arrival), truth)[device > 60 * S]) < 1.0

    def test_a_nominal_rate_may_be_one_percent_off(self) -> None:
        clock = DeviceClock(COUNTER_ONLY)
        truth = device_times(101.0, 200.0).astype(np.float64)
        arrival = usb_arrivals(truth, 16.0 * MS, np.random.default_rng(6))
        counter = np.arange(len(truth)) % 256
        device, segment = clock.process(counter, None, arrival, len(counter))
        host = HostClock(clock.drift_limit_ppm).process(device, segment, arrival)
        assert p99(error_ms(host, truth)[truth > 60 * S]) < 0.5

    def test_backlog_at_the_start_is_forgotten(self) -> None:
        device = device_times(100.0, 60.0)
        arrival = EPOCH + np.maximum(device + LATENCY, 3 * S)
        error = np.abs(error_ms(fit(device, arrival), device.astype(np.float64)))
        # Until 3 s are a sixth of the span, the slope is at its limit, 500 ppm.
        assert np.max(error[device > 3 * S]) < 500e-6 * 15_000
        assert np.max(error[device > 19 * S]) < 0.01

    def test_rows_without_arrival_have_no_host_time_and_change_nothing(self) -> None:
        device = device_times(100.0, 20.0)
        arrival = usb_arrivals(device.astype(np.float64), 16.0 * MS, np.random.default_rng(7))
        with_holes = arrival.copy()
        with_holes[::3] = NO_INT
        host = fit(device, with_holes)
        known = with_holes != NO_INT
        assert np.all(host[~known] == NO_INT)
        np.testing.assert_array_equal(host[known], fit(device[known], arrival[known]))

    def test_a_curve_that_bends_upwards_stays_in_bounded_memory(self) -> None:
        device = device_times(100.0, 400.0)
        bend = (device / S) ** 2 * 10.0
        arrival = EPOCH + device + bend.astype(np.int64)
        host = fit(device, arrival)
        assert np.all(host <= arrival)
        # The tangent in the middle of the memory of 300 s lags by 150² * 10 ns.
        assert np.max(arrival - host) < 1.1 * 150**2 * 10


def hull_twin(x: RealArray, y: RealArray, at: float) -> float:
    """Return the highest value at `at` of a line below all points: their lower hull."""
    result = linprog([-1.0, 0.0], np.column_stack([np.ones_like(x), x - at]), y, bounds=(None, None))
    return float(result.x[0])


def fit_twin(x: IntArray, y: IntArray, limit: float = 500e-6) -> tuple[float, float]:
    """Return slope and last offset of the line below the remembered points, by linear programming."""
    remembered = x // BLOCK_NS > x[-1] // BLOCK_NS - BLOCKS
    seconds, ms = x[remembered] / S, y[remembered] / MS
    mean = np.mean(seconds)
    span = seconds[-1] - seconds[0]
    ends = seconds[0] + span * MARGIN, seconds[-1] - span * MARGIN
    left, right = (hull_twin(seconds, ms, x) for x in ends)
    chord = (right - left) / (ends[1] - ends[0])
    distance = np.mean(ms) - left - chord * (mean - ends[0])
    sigma_chord = TOUCH * distance / span
    sigma_prior = PRIOR * limit * 1e3
    slope = chord * sigma_prior**2 / (sigma_prior**2 + sigma_chord**2)
    slope = float(np.clip(slope, -limit * 1e3, limit * 1e3))
    offset = float(np.min(ms - slope * (seconds - seconds[-1])))
    return slope * 1e-3, offset * MS


@dataclass(frozen=True)
class Packets:
    """What a device sent and when it came."""

    counter: IntArray
    ticks: IntArray
    arrival: IntArray

    def part(self, start: int | None, stop: int | None = None) -> Packets:
        rows = slice(start, stop)
        return Packets(self.counter[rows], self.ticks[rows], self.arrival[rows])

    def without(self, start: int, stop: int) -> Packets:
        keep = np.r_[0:start, stop : len(self.counter)]
        return Packets(self.counter[keep], self.ticks[keep], self.arrival[keep])

    def then(self, other: Packets) -> Packets:
        return Packets(
            np.concatenate([self.counter, other.counter]),
            np.concatenate([self.ticks, other.ticks]),
            np.concatenate([self.arrival, other.arrival]),
        )

    def unseen(self) -> Packets:
        return replace(self, arrival=np.full_like(self.arrival, NO_INT))


def packets(
    n: int, timing: Timing = MICROSECONDS, uptime_s: float = 0.0, counter: int = 0, start_s: float = 0.0
) -> Packets:
    """Return n packets at 100 Hz, the first at `uptime_s` of the device's clock, `start_s` of the host's."""
    rng = np.random.default_rng(n)
    elapsed = np.arange(n) * 10 * MS
    ticks = (int(uptime_s * S) + elapsed) // int(timing.tick_ns or 1)
    arrival = usb_arrivals(elapsed + start_s * S, 16.0 * MS, rng)
    bits = timing.counter_bits or 62
    return Packets((np.arange(n) + counter) % (1 << bits), ticks % (1 << (timing.tick_bits or 62)), arrival)


def unwrap(clock: DeviceClock, sent: Packets) -> tuple[IntArray, IntArray]:
    return clock.process(sent.counter, sent.ticks, sent.arrival, len(sent.counter))


U16 = MICROSECONDS._replace(counter_bits=16)


class TestDeviceClock:
    @settings(deadline=None, max_examples=50)
    @given(
        steps=st.lists(st.integers(1, 120), min_size=1, max_size=60),
        bits=st.sampled_from([8, 16, 32]),
        tick=st.sampled_from([Fraction(1), Fraction(10**9, 32768), Fraction(50_000, 3), Fraction(10**6)]),
        start=st.integers(0, 2**32 - 1),
        arrivals=st.booleans(),
    )
    def test_unwraps_any_range_exactly(
        self, steps: list[int], bits: int, tick: Fraction, start: int, arrivals: bool
    ) -> None:
        start %= 1 << bits
        count = start + np.cumsum(steps)
        timing = Timing(tick_ns=tick, tick_bits=bits)
        truth = [int(value) * tick.numerator // tick.denominator for value in count]
        base = truth[0] - int(count[0] % (1 << bits)) * tick
        arrival = EPOCH + np.array(truth) if arrivals else None
        time, segment = DeviceClock(timing).process(None, count % (1 << bits), arrival, len(count))
        np.testing.assert_allclose(time, [value - int(base) for value in truth], atol=1, rtol=0)
        assert not segment.any()

    def test_hours_of_a_microsecond_clock_in_blocks(self) -> None:
        sent = packets(3 * 360_000, uptime_s=10.0, counter=3)
        clock = DeviceClock(MICROSECONDS)
        parts = [unwrap(clock, sent.part(k, k + 5000))[0] for k in range(0, len(sent.counter), 5000)]
        expected = 10 * S + np.arange(len(sent.counter)) * 10 * MS
        np.testing.assert_array_equal(np.concatenate(parts), expected)
        assert (clock.resets, clock.counter_gaps, clock.packets_missing) == (0, 0, 0)

    def test_a_64_bit_unix_clock_keeps_its_nanoseconds(self) -> None:
        ticks = EPOCH + np.arange(5, dtype=np.int64)
        time, _ = DeviceClock(Timing(tick_ns=Fraction(1), tick_bits=64)).process(None, ticks, ticks, 5)
        np.testing.assert_array_equal(time, ticks)

    @pytest.mark.parametrize("bits", [7, 8, 16])
    def test_gap_of_ten_seconds_is_counted_by_the_clock(self, bits: int) -> None:
        timing = MICROSECONDS._replace(counter_bits=bits)
        sent = packets(4000, timing, uptime_s=4290.0).without(1500, 2501)
        clock = DeviceClock(timing)
        time, segment = unwrap(clock, sent)
        assert time[1500] - time[1499] == 1002 * 10 * MS
        assert (clock.packets_missing, clock.counter_gaps, segment[-1]) == (1001, 1, 0)

    def test_gap_of_ten_seconds_is_counted_by_the_arrivals_when_there_is_no_clock(self) -> None:
        sent = packets(4000, COUNTER_ONLY).without(1500, 2501)
        clock = DeviceClock(COUNTER_ONLY)
        time, segment = clock.process(sent.counter, None, sent.arrival, len(sent.counter))
        assert time[1500] - time[1499] == 1002 * 10 * MS
        assert (clock.packets_missing, clock.counter_gaps, segment[-1]) == (1001, 1, 0)

    def test_lost_packets_leave_their_room(self) -> None:
        counter = np.array([250, 251, 254, 255, 0, 3])
        clock = DeviceClock(COUNTER_ONLY)
        time, _ = clock.process(counter, None, None, 6)
        np.testing.assert_array_equal(time, np.array([250, 251, 254, 255, 256, 259]) * 10 * MS)
        assert (clock.packets_missing, clock.counter_gaps) == (4, 2)

    @pytest.mark.parametrize("seen", [True, False])
    @pytest.mark.parametrize("timing", [MICROSECONDS, U16, U16._replace(tick_bits=0)])
    @pytest.mark.parametrize("uptime_s", [100.0, 2000.0, 2500.0, 4200.0])
    def test_reboot_begins_a_segment(self, uptime_s: float, timing: Timing, seen: bool) -> None:
        sent = packets(1000, timing, uptime_s, counter=17)
        both = sent.then(packets(500, timing, 0.5, start_s=13.0))
        clock = DeviceClock(timing)
        time, segment = unwrap(clock, both if seen else both.unseen())
        np.testing.assert_array_equal(segment, np.arange(1500) >= 1000)
        assert time[1000] == 500 * MS
        assert (clock.resets, clock.packets_missing) == (1, 0)

    def test_reboot_that_looks_like_a_wrap_is_betrayed_by_the_counter(self) -> None:
        sent = packets(1000, U16, 4270.0, counter=17).then(packets(500, U16, 0.5)).unseen()
        clock = DeviceClock(U16)
        _, segment = unwrap(clock, sent)
        np.testing.assert_array_equal(segment, np.arange(1500) >= 1000)

    def test_reboot_is_detected_although_the_counter_goes_on_by_chance(self) -> None:
        sent = packets(1000, uptime_s=2500.0).then(packets(500, counter=1000 % 256, start_s=13.0))
        clock = DeviceClock(MICROSECONDS)
        _, segment = unwrap(clock, sent)
        assert (np.flatnonzero(np.diff(segment)).tolist(), clock.resets) == ([999], 1)

    def test_restart_of_the_counter_alone_begins_a_segment(self) -> None:
        sent = packets(1000, U16, uptime_s=5.0).then(packets(500, U16, uptime_s=15.0, start_s=10.0))
        clock = DeviceClock(U16)
        _, segment = unwrap(clock, sent)
        assert (np.flatnonzero(np.diff(segment)).tolist(), clock.resets) == ([999], 1)

    def test_a_clock_set_back_a_little_begins_a_segment(self) -> None:
        sent = packets(200, U16, uptime_s=100.0)
        sent.ticks[100:] -= 500_000
        clock = DeviceClock(U16)
        _, segment = unwrap(clock, sent)
        assert clock.resets == 1
        assert segment[99] == 0
        assert np.all(segment[100:] == 1)

    def test_clock_set_forward_begins_a_segment(self) -> None:
        sent = packets(1000).then(packets(500, uptime_s=3000.0, counter=1000 % 256, start_s=10.0))
        clock = DeviceClock(MICROSECONDS)
        time, segment = unwrap(clock, sent)
        assert segment[-1] == 1
        assert time[1000] == 3000 * S

    def test_reboot_of_a_16_bit_counter_without_clock_is_detected_by_the_arrivals(self) -> None:
        timing = Timing(counter_bits=16, rate_hz=100.0)
        sent = packets(1000, timing, counter=40_000).then(packets(500, timing, start_s=12.0))
        clock = DeviceClock(timing)
        _, segment = clock.process(sent.counter, None, sent.arrival, 1500)
        assert (np.flatnonzero(np.diff(segment)).tolist(), clock.resets) == ([999], 1)

    @pytest.mark.parametrize("timing", [MICROSECONDS, U16, COUNTER_ONLY])
    def test_host_that_stalls_for_eight_seconds_is_no_restart(self, timing: Timing) -> None:
        sent = packets(4000, timing, uptime_s=4280.0)
        stalled = np.where(
            (sent.arrival > EPOCH + 10 * S) & (sent.arrival < EPOCH + 18 * S), EPOCH + 18 * S, sent.arrival
        )
        clock = DeviceClock(timing)
        ticks = sent.ticks if timing.tick_ns else None
        time, segment = clock.process(sent.counter, ticks, stalled, 4000)
        assert np.all(np.diff(time) == 10 * MS)
        assert (bool(segment.any()), clock.resets, clock.packets_missing) == (False, 0, 0)

    @pytest.mark.parametrize("step_s", [-3600, 3600])
    def test_host_clock_that_is_set_is_no_restart(self, step_s: int) -> None:
        sent = packets(2000, uptime_s=4290.0)
        sent.arrival[1000:] += step_s * S
        time, segment = unwrap(DeviceClock(MICROSECONDS), sent)
        assert np.all(np.diff(time) == 10 * MS)
        assert not segment.any()

    def test_repeated_packets_are_neither_lost_nor_a_restart(self) -> None:
        sent = packets(500)
        twice = Packets(*(np.repeat(values, 2) for values in (sent.counter, sent.ticks, sent.arrival)))
        for timing, ticks in ((MICROSECONDS, twice.ticks), (COUNTER_ONLY, None)):
            clock = DeviceClock(timing)
            time, segment = clock.process(twice.counter, ticks, twice.arrival, 1000)
            np.testing.assert_array_equal(time[::2], time[1::2])
            assert (bool(segment.any()), clock.resets, clock.packets_missing) == (False, 0, 0)

    def test_device_that_pauses_is_no_restart(self) -> None:
        first = packets(1000, U16)
        sent = first.then(packets(500, U16, uptime_s=40.0, counter=1000, start_s=40.0))
        clock = DeviceClock(U16)
        time, segment = unwrap(clock, sent)
        assert time[1000] == 40 * S
        assert (bool(segment.any()), clock.packets_missing) == (False, 0)

    @pytest.mark.parametrize(("uptime_s", "restarts"), [(28.0, 0), (22.0, 1), (0.5, 1)])
    def test_reopened_port_only_restarts_a_clock_that_did_not_go_on(
        self, uptime_s: float, restarts: int
    ) -> None:
        # Up for 18 s when the port was lost; 10 s later it is open again.
        clock = DeviceClock(MICROSECONDS)
        unwrap(clock, packets(800, uptime_s=10.0))
        clock.new_connection()
        counter = 1800 % 256 if not restarts else 0
        _, segment = unwrap(clock, packets(500, uptime_s=uptime_s, counter=counter, start_s=18.0))
        assert (clock.resets, set(segment.tolist())) == (restarts, {restarts})
        assert clock.packets_missing == (0 if restarts else 1000)

    def test_rows_without_time_hold_it_and_upset_nothing(self) -> None:
        sent = packets(2000, uptime_s=4290.0)
        holes = np.random.default_rng(0).random(2000) < 0.3
        holes[0] = False
        ticks = np.where(holes, NO_INT, sent.ticks)
        clock = DeviceClock(MICROSECONDS)
        time, segment = clock.process(sent.counter, ticks, sent.arrival, 2000)
        whole, _ = unwrap(DeviceClock(MICROSECONDS), sent)
        last = np.maximum.accumulate(np.where(holes, 0, np.arange(2000)))
        np.testing.assert_array_equal(time, whole[last])
        assert (bool(segment.any()), clock.packets_missing) == (False, 0)

    def test_device_that_stops_sending_its_time_falls_back_to_the_counter(self) -> None:
        sent = packets(3000)
        ticks = sent.ticks.copy()
        ticks[500:] = NO_INT
        clock = DeviceClock(MICROSECONDS)
        time, segment = clock.process(sent.counter, ticks, sent.arrival, 3000)
        assert (segment[1499], segment[1500], clock.resets) == (0, 1, 0)
        assert np.all(np.diff(time[1500:]) == 10 * MS)

    def test_sources_in_order_ticks_counter_rows_arrivals(self) -> None:
        sent = packets(4, MICROSECONDS._replace(counter_bits=16), uptime_s=3.0, counter=7)
        both = DeviceClock(MICROSECONDS).process(sent.counter, sent.ticks, sent.arrival, 4)[0]
        counted = DeviceClock(MICROSECONDS).process(sent.counter, None, sent.arrival, 4)[0]
        rows = DeviceClock(Timing(rate_hz=400.0)).process(None, None, sent.arrival, 4)[0]
        arrivals = DeviceClock(Timing()).process(None, None, sent.arrival, 4)[0]
        np.testing.assert_array_equal(both, 3 * S + np.arange(4) * 10 * MS)
        np.testing.assert_array_equal(counted, (7 + np.arange(4)) * 10 * MS)
        np.testing.assert_array_equal(rows, np.arange(4) * 2_500_000)
        np.testing.assert_array_equal(arrivals, sent.arrival)

    def test_samples_that_cannot_be_dated_are_refused(self) -> None:
        with pytest.raises(ImumonError) as caught:
            DeviceClock(Timing(counter_bits=8)).process(np.arange(3), None, None, 3)
        assert caught.value.reason is Reason.BAD_CONFIG

    @pytest.mark.parametrize(
        "timing",
        [
            Timing(tick_ns=Fraction(0)),
            Timing(tick_ns=Fraction(10**12 + 1, 10**9)),
            Timing(rate_hz=0.0),
        ],
    )
    def test_impossible_timing_is_refused(self, timing: Timing) -> None:
        with pytest.raises(ImumonError) as caught:
            DeviceClock(timing)
        assert caught.value.reason is Reason.BAD_CONFIG


@settings(deadline=None, max_examples=30)
@given(
    cuts=st.lists(st.integers(0, 2400), max_size=8),
    seed=st.integers(0, 1000),
    timing=st.sampled_from([MICROSECONDS, U16, COUNTER_ONLY, Timing(rate_hz=100.0), Timing()]),
)
def test_results_do_not_depend_on_the_division_into_blocks(
    cuts: list[int], seed: int, timing: Timing
) -> None:
    rng = np.random.default_rng(seed)
    sent = packets(1000, timing, uptime_s=4290.0).without(300, 600)
    sent = sent.then(packets(1700, timing, start_s=40.0))
    for values in (sent.counter, sent.ticks, sent.arrival):
        values[rng.random(len(values)) < 0.02] = NO_INT
    n = len(sent.counter)

    def run(bounds: list[int]) -> IntArray:
        device, host = DeviceClock(timing), HostClock()
        out = []
        for start, stop in pairwise(bounds):
            part = sent.part(start, stop)
            time, segment = unwrap(device, part)
            out.append(np.array([time, segment, host.process(time, segment, part.arrival)]))
        counts = [[device.resets, device.packets_missing, device.counter_gaps]]
        return np.concatenate([*out, np.transpose(counts)], axis=1)

    np.testing.assert_array_equal(run([0, n]), run(sorted({0, n, *cuts})))


@settings(deadline=None, max_examples=50)
@given(data=st.data())
def test_any_input_gives_ordered_times(data: st.DataObject) -> None:
    n = data.draw(st.integers(0, 40))
    value = st.integers(-(2**63), 2**63 - 1) | st.integers(0, 300)
    arrivals = st.integers(EPOCH, EPOCH + 100 * S) | st.just(NO_INT)
    counter = np.array(data.draw(st.lists(value, min_size=n, max_size=n)), np.int64)
    ticks = np.array(data.draw(st.lists(value, min_size=n, max_size=n)), np.int64)
    arrival = np.array(sorted(data.draw(st.lists(arrivals, min_size=n, max_size=n))), np.int64)
    timing = data.draw(
        st.sampled_from([MICROSECONDS, COUNTER_ONLY, Timing(tick_ns=Fraction(1, 3)), Timing()])
    )
    time, segment = DeviceClock(timing).process(counter, ticks, arrival, n)
    host = HostClock().process(time, segment, arrival)
    same = np.diff(segment) == 0
    assert np.all(np.diff(segment) >= 0)
    dated = np.flatnonzero(time != 0)  # before the first count that can be there is no time
    assert np.all(np.diff(time)[same][dated[0] if len(dated) else n :] >= 0)
    known = arrival != NO_INT
    assert np.all(host[known] <= arrival[known])
    assert np.all(host[~known] == NO_INT)
    assert np.all(np.diff(host[known]) >= 0)
