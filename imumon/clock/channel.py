"""The rate of the device's clock as a channel: device time against the times at which its packets arrived.

What a slot knows of the clock is the least delay of its packets, arrival less device time.  The rate is how
that falls from one slot to the next.  Means over a block telescope: they hang on the delays at its two ends
alone, however late the packets between were, and an error at an end is in both blocks that meet there.  The
host's own clock is the measure; what that errs by, or is slewed by, is in the rate as well.
"""

from collections.abc import Iterable, Iterator

import numpy as np

from imumon.blocks import NO_INT, FloatArray, SampleBlock

CLOCK = "clock"
UNIT = "ppm"
"""Positive when the device's clock is fast."""
MICROSECOND_NS = 1000.0


def with_delay(blocks: Iterable[SampleBlock]) -> Iterator[SampleBlock]:
    """Yield blocks with arrival less device time in µs as the column `CLOCK`, from the first that has both.

    Where the device's time is that of the arrivals there is nothing to compare, and the column is missing.
    """
    first: int | None = None
    for block in blocks:
        if "arrival_time_ns" in block and "device_time_ns" in block:
            arrival, device = block["arrival_time_ns"], block["device_time_ns"]
            known = (arrival != NO_INT) & (device != NO_INT)
            delay = arrival - device
            if first is None and known.any():
                first = int(delay[known][0])
            if first is not None and (delay[known] != first).any():
                block = block.with_columns({CLOCK: np.where(known, (delay - first) / MICROSECOND_NS, np.nan)})
        yield block


def rate_ppm(least_delay_us: FloatArray, slot_s: float) -> FloatArray:
    """Return the rate of the device's clock less that of the host's in each slot, (n,), from the least delay.

    It is the step to the next slot; NaN in the last, and beside a gap.
    """
    return np.append(-np.diff(least_delay_us) / slot_s, np.nan)


def block_noise(rates: FloatArray) -> float:
    """Return the standard deviation that the delays leave in the rate of a block, from the rates of blocks.

    An error e of a delay is e / T in one block and -e / T in the next.  The second difference of the rates,
    which no steady change of the rate is in, has (e0 - 3 e1 + 3 e2 - e3) / T: its mean square is ten times
    the variance 2 e² / T² of one.
    """
    steps = np.diff(rates, 2)
    known = steps[np.isfinite(steps)]
    return float(np.sqrt(np.mean(known**2) / 10.0)) if len(known) else float("nan")
