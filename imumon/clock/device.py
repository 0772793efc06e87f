"""The device's own time: counter and ticks unwrapped, restarts distinguished from wraps, gaps and stalls.

Known of a step from one packet to the next are the step of the device's count, modulo its range, and the step
of the arrival time, which a stalled host or a full buffer delays by seconds.  The rules:

- A clock that does not wrap and goes back has restarted.
- A count that wraps has gone forwards.  How many times round, the arrival times give, unless the step is so
  small that nothing can have been lost.
- A step that runs ahead of the arrivals by more than `SLACK_NS` is a restart; so is one that falls behind by
  that, unless nothing was lost (then the host or the device has paused).
- When the port was reopened, nothing can be queued, and `REOPENED_SLACK_NS` either way is enough.
- Without arrival times, a wrapping count that goes back is taken for a wrap if the step is not above
  `UNSEEN_GAP_NS`.
- A packet counter that advances by many more packets than the device's clock has room for has restarted.
  The reverse is a device that has paused.
- The same counter again is a repeated packet (or another message about the same sample), not a loss.

A restart that leaves the count within the slack of where it would have been looks like a gap; `HostClock`
then detects the offset step.  So does any restart of a device without a clock whose counter wraps within the
slack (8 bits at 100 Hz).
"""

from collections.abc import Sequence
from fractions import Fraction
from typing import Final, Literal

import numpy as np

from imumon.blocks import NO_INT, IntArray, missing
from imumon.compiled import inner, njit, record, records
from imumon.errors import bad_config
from imumon.protocols.base import Timing

from .host import CRYSTAL_PPM

SLACK_NS = 10_000_000_000
"""Packets may queue for this long in the buffers of adapter and host."""
REOPENED_SLACK_NS = 2_000_000_000
"""The same just after the port was opened, when the buffers are empty."""
UNSEEN_GAP_NS = 60_000_000_000
"""Longest gap in which a wrap is believed when there are no arrival times."""
SCATTER_NS = 100_000_000
"""Arrivals scatter this much, so a count that wraps more quickly is not taken round for less."""
CLOCK_STEADINESS = 1000
"""A clock is at least this exact (one part in...)."""
RATE_STEADINESS = 20
"""A sensor's own oscillator is at least this close to the nominal rate (one part in...)."""
DELAY_MEMORY_NS = 10_000_000_000
"""Device time in which the usual delay follows an increase."""
LOST_SOURCE_ROWS = 1000
"""Rows without the usual count after which the next best one is used."""
PERIOD_MEMORY = 16
"""Packets over which the packet period is averaged; it changes by no more than this part at once."""
RESTARTED_FACTOR, RESTARTED_PACKETS = 4, 16
"""A counter that is this far ahead of the clock (factor, and packets besides) has restarted."""
MAX_TIME_NS = 1 << 61
"""Device times beyond this (73 years) are damage."""

# What the device time comes from; a better source has a higher number.
ARRIVALS, ROWS, COUNTER, TICKS = range(4)
NO_SOURCE = -1
DatedBy = Literal["", "arrival", "rows", "counter", "clock"]
DATED_BY: Final[Sequence[DatedBy]] = ("arrival", "rows", "counter", "clock", "")
"""By the number of the source; the last is that of `NO_SOURCE`."""
RESTART = -1


class _Source:
    """A count is numerator / denominator ns; it wraps at the modulus, 0: never.

    Counts beyond the limit are damage (0: the device has no such source).  1 / steadiness is how exact the
    unit is.
    """

    numerator: int
    denominator: int
    modulus: int
    limit: int
    steadiness: int


class _State:
    counter_modulus: int
    source: int
    segment: int
    row: int
    raw: int
    count: int
    time: int
    held: int
    last_arrival: int
    time_at_arrival: int
    usual_delay: int
    reopened: int
    raw_counter: int
    held_packets: int
    time_at_counter: int
    period: int
    gaps: int
    missing: int
    resets: int


class DeviceClock:
    """Device time of each sample, causal, in constant memory, whatever the division into blocks.

    The source is the best that has come in the stream: the device's ticks; else the packet counter
    divided by the nominal rate, so that lost packets leave their room; else the row number divided by the
    rate; else the arrival time.  When a better source appears, a new segment begins.  A row that lacks the
    source has the time of the row before; after 1000 such rows the next best source takes over, in a new
    segment.

    Raises BAD_CONFIG when the numbers in `timing` cannot be.

    `timing`: how the device counts.
    """

    def __init__(self, timing: Timing) -> None:
        self.timing = timing
        period = _check(timing)
        self._sources = _sources(timing, period)
        self._state = record(_State)
        self._state.counter_modulus = 1 << timing.counter_bits if timing.counter_bits else 0
        self._state.source = NO_SOURCE
        self._state.last_arrival = self._state.raw_counter = NO_INT
        self._state.period = int(period) if period else 0

    @property
    def drift_limit_ppm(self) -> float:
        """How far the device's time may run from the host's: a crystal's limit, or that of a nominal rate."""
        return CRYSTAL_PPM if self.timing.tick_ns is not None else 1e6 / RATE_STEADINESS

    @property
    def dated_by(self) -> DatedBy:
        """What dates the rows now; empty before the first."""
        return DATED_BY[int(self._state.source)]

    @property
    def packets_counted(self) -> bool:
        """Whether a packet counter has come, by which it is known how many packets are missing."""
        return int(self._state.raw_counter) != NO_INT

    @property
    def counter_gaps(self) -> int:
        """Times that the packet counter skipped values."""
        return int(self._state.gaps)

    @property
    def packets_missing(self) -> int:
        """Packets that did not come, by the counter; those around a restart are not known."""
        return int(self._state.missing)

    @property
    def resets(self) -> int:
        """Restarts of the device's clock or counter."""
        return int(self._state.resets)

    def new_connection(self) -> None:
        """Note that the port was opened anew before the next sample: nothing can have queued up."""
        self._state.reopened = 1

    def process(
        self,
        packet_counter: IntArray | None,
        device_ticks: IntArray | None,
        arrival_ns: IntArray | None,
        n: int,
    ) -> tuple[IntArray, IntArray]:
        """Return device time in ns (n,) and segment (n,) for samples in order of arrival.

        Raises BAD_CONFIG when neither ticks, counter, rate nor arrival times can date the samples.

        `packet_counter`, `device_ticks` (n,): as the device sends them, `NO_INT` where it does not.
        `arrival_ns` (n,): Unix time in ns, `NO_INT` where it is not known.
        `n`: number of samples.
        """
        dated = self._sources[TICKS].limit and device_ticks is not None
        if n and not dated and not self._sources[ROWS].limit and arrival_ns is None:
            what = "the samples have no device clock, no rate and no arrival times, so they cannot be dated"
            raise bad_config(what, "give rate_hz in the device file")
        time_ns, segment = np.empty((2, n), np.int64)
        absent = missing(n, np.int64)
        sent = (packet_counter, device_ticks, arrival_ns)
        counter, ticks, arrival = (absent if one is None else one for one in sent)
        _unwrap(counter, ticks, arrival, self._sources, self._state, time_ns, segment)
        return time_ns, segment


def _check(timing: Timing) -> Fraction | None:
    """Return the nominal period in ns, to a thousandth, or None; refuse impossible numbers."""
    tick, rate_hz = timing.tick_ns, timing.rate_hz
    # A remainder of ticks times the numerator must fit int64.
    can_tick = tick is None or (tick > 0 and tick.numerator * tick.denominator < 1 << 62)
    if not (can_tick and (rate_hz is None or 1e-3 <= rate_hz <= 1e6)):
        raise bad_config(
            f"no device counts like this: {timing}",
            "a tick is a positive, simple fraction, a rate from 0.001 Hz to 1 MHz",
        )
    return None if rate_hz is None else (10**9 / Fraction(rate_hz)).limit_denominator(1000)


def _sources(timing: Timing, period: Fraction | None) -> Sequence[_Source]:
    """Return the sources, worst first."""
    table = records(_Source, 4)
    counted = period if timing.counter_bits else None
    entries = [
        (ARRIVALS, Fraction(1), 0, CLOCK_STEADINESS),
        (ROWS, period, 0, RATE_STEADINESS),
        (COUNTER, counted, timing.counter_bits or 0, RATE_STEADINESS),
        (TICKS, timing.tick_ns, timing.tick_bits, CLOCK_STEADINESS),
    ]
    for number, unit, bits, steadiness in entries:
        if unit is not None:
            source = table[number]
            source.numerator, source.denominator, source.steadiness = *unit.as_integer_ratio(), steadiness
            source.limit = min(int(MAX_TIME_NS / unit), MAX_TIME_NS)
            # A range beyond the limit never wraps.
            source.modulus = 1 << bits if bits and 1 << bits <= source.limit else 0
    return table


@njit
def _unwrap(
    counter: IntArray,
    ticks: IntArray,
    arrival: IntArray,
    sources: Sequence[_Source],
    state: _State,
    time_ns: IntArray,
    segment: IntArray,
) -> None:
    for i in range(len(time_ns)):
        number, raw = _best(sources, state, counter[i], ticks[i], arrival[i])
        source = sources[number]
        counted = state.counter_modulus != 0 and counter[i] != NO_INT
        packets = 0  # by how much the packet counter has advanced, modulo its range; 0 where it is not known
        if counted and state.raw_counter != NO_INT:
            packets = (counter[i] - state.raw_counter) % state.counter_modulus
        state.row += 1
        if number == NO_SOURCE or (number < state.source and state.held < LOST_SOURCE_ROWS):
            state.held += 1
            state.held_packets += packets
        elif number != state.source:
            state.segment += state.source != NO_SOURCE
            _begin(source, state, number, raw, arrival[i])
        else:
            step = _step(source, state, raw, arrival[i])
            if number == COUNTER:
                packets = step
            elif number == TICKS and step != RESTART:
                packets = _packets_in(source, state, packets, counted, step)
            if step == RESTART or packets == RESTART:
                packets = 0
                state.segment += 1
                state.resets += number >= COUNTER
                _begin(source, state, number, raw, arrival[i])
            else:
                _advance(source, state, raw, step, arrival[i])
        if counted:
            state.raw_counter = counter[i] % state.counter_modulus
        if packets > 1:
            state.gaps += 1
            state.missing += packets - 1
        time_ns[i] = state.time
        segment[i] = state.segment


@inner
def _best(
    sources: Sequence[_Source], state: _State, counter: int, ticks: int, arrival: int
) -> tuple[int, int]:
    """Return the best source that this row has, and its count."""
    if sources[TICKS].limit and -sources[TICKS].limit <= ticks <= sources[TICKS].limit:
        modulus = sources[TICKS].modulus
        return TICKS, ticks % modulus if modulus else ticks
    if sources[COUNTER].limit and counter != NO_INT:
        return COUNTER, counter % state.counter_modulus
    if sources[ROWS].limit:
        return ROWS, state.row
    if arrival != NO_INT:
        return ARRIVALS, arrival
    return NO_SOURCE, 0


@inner
def _packets_in(source: _Source, state: _State, packets: int, counted: bool, step: int) -> int:
    """Return by how much the packet counter has advanced while the clock made `step`, or RESTART.

    Learns the packet period on the way, from steps of one packet, or from every row if there is no counter.
    """
    first = state.raw_counter == NO_INT
    if not counted and not first:
        return 0
    held, period, modulus = state.held_packets, state.period, state.counter_modulus
    elapsed = _ns(source, state.count + step) - state.time_at_counter
    state.time_at_counter += elapsed
    state.held_packets = 0
    if period == 0 and (first or held + packets == 1):
        state.period = elapsed
    elif first or held + packets == 1:
        most = period // PERIOD_MEMORY
        state.period = max(period + min(max((elapsed - period) // PERIOD_MEMORY, -most), most), 1)
    if first or period == 0:
        return packets
    room = elapsed // period
    rounds = (room - held - packets + modulus // 2) // modulus
    # The clock may be coarse: one tick more or less.
    most = RESTARTED_FACTOR * (elapsed + _ns(source, 1)) // period + RESTARTED_PACKETS
    return RESTART if held + packets > most else int(packets + max(rounds, 0) * modulus)


@inner
def _ns(source: _Source, count: int) -> int:
    """Return counts in ns, rounded down, without the overflow that count * numerator might have."""
    whole = count // source.denominator
    part = count % source.denominator
    return int(whole * source.numerator + part * source.numerator // source.denominator)


@inner
def _step(source: _Source, state: _State, raw: int, arrival: int) -> int:
    """Return by how many counts the source has advanced, or RESTART."""
    step = raw - state.raw
    if source.modulus:
        step %= source.modulus
    elif step < 0:
        return RESTART
    step_ns = _ns(source, step)
    small = 2 * step_ns <= 3 * state.period
    if arrival == NO_INT or state.last_arrival == NO_INT:
        return RESTART if raw < state.raw and step_ns > UNSEEN_GAP_NS else int(step)
    expected_ns = arrival - state.usual_delay - state.time
    tolerance_ns = abs(expected_ns) // source.steadiness
    if source.modulus and (state.reopened or not small):
        range_ns = _ns(source, source.modulus)
        lacking_ns = expected_ns - step_ns
        if lacking_ns > max(SCATTER_NS, range_ns // 2):
            step += (lacking_ns + range_ns // 2) // range_ns * source.modulus
            step_ns = _ns(source, step)
    if state.reopened:
        return RESTART if abs(step_ns - expected_ns) > REOPENED_SLACK_NS + tolerance_ns else int(step)
    if small:
        return int(step)
    behind_ns = (arrival - state.last_arrival) - (state.time + step_ns - state.time_at_arrival)
    return RESTART if max(step_ns - expected_ns, behind_ns) > SLACK_NS + tolerance_ns else int(step)


@inner
def _begin(source: _Source, state: _State, number: int, raw: int, arrival: int) -> None:
    state.source = number
    state.count = raw
    state.last_arrival = NO_INT
    state.reopened = 0
    _advance(source, state, raw, 0, arrival)
    state.held_packets = 0
    state.time_at_counter = state.time


@inner
def _advance(source: _Source, state: _State, raw: int, step: int, arrival: int) -> None:
    """Move device time on, and with it the delay that is usual: down at once, up in ten seconds."""
    state.held = 0
    state.raw = raw
    state.count += step
    state.time = _ns(source, state.count)
    if arrival == NO_INT:
        return
    delay = arrival - state.time
    more = delay - state.usual_delay
    if state.last_arrival == NO_INT or more < 0:
        state.usual_delay = delay
    else:
        elapsed = min(state.time - state.time_at_arrival, DELAY_MEMORY_NS)
        state.usual_delay += int(more * (elapsed / DELAY_MEMORY_NS))
    state.last_arrival = arrival
    state.time_at_arrival = state.time
    state.reopened = 0
