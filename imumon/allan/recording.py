"""The channels of a recording for the Allan deviation, and what the user should know of it."""

from collections.abc import Iterable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np

from imumon.blocks import SampleBlock, join
from imumon.columns import TEMPERATURES
from imumon.errors import bad_data
from imumon.estimation.gyro_bias.stage import RestDetector
from imumon.recordings.reduced import ACCEL, GYRO
from imumon.recordings.source import Count, no_count, open_recording

from .series import PARTS, EvenSeries, even_channels

UNITS = {"gyro": "rad/s", "accel": "m/s^2"}
CHANNELS = (*GYRO, *ACCEL)
WANTED = ("device_time_ns", "segment", "at_rest", *CHANNELS, *TEMPERATURES)
FEWEST_SAMPLES = 64
LEAST_USED = 0.5
"""A recording of which less can be used has no even rate."""
WARMING_DEGC = 0.5
MOST_JITTER = 0.05
"""Share of the interval: less variation of the time from sample to sample is not reported."""
MOVING_SHARE, LEAST_FOR_MOTION_S = 0.01, 10.0
"""Less is put down to the rest detector, which cannot detect rest before so many s."""
SHORT_S = 300.0
"""Bias instability shows at averaging times of minutes, which a shorter recording does not have."""
FASTEST_HZ = 5e4
"""No IMU sends faster; a column device_time_ns in another unit would."""


class Channels(NamedTuple):
    """The channels that are there, on an even grid, and warnings about them."""

    series: dict[str, EvenSeries]
    warnings: list[str]


def read_channels(path: Path, count: Count = no_count) -> Channels:
    """Read the gyro and accelerometer channels of a session, or of a table of samples.

    Raises BAD_DATA when there is nothing to read, no such channel, too few samples or no even rate.
    """
    recording = open_recording(path, lambda _: [RestDetector()], count=count)
    stated = recording.source.imported
    for name in CHANNELS:
        unit, own = stated[name].unit if name in stated else "", UNITS[group_of(name)]
        if unit not in ("", own):
            raise bad_data(
                f"{path}: {name} is in {unit}, not in {own}",
                "a table from elsewhere becomes a session first: imumon import",
            )
    blocks = [
        SampleBlock({name: block[name].copy() for name in WANTED if name in block})
        for block in recording.blocks()
    ]
    if not blocks:
        raise bad_data(f"{path}: has no samples")
    samples = join(blocks)
    there = [name for name in CHANNELS if name in samples]
    channels = {name: samples[name] for name in there if np.isfinite(samples[name]).sum() > 1}
    if not channels:
        raise bad_data(f"{path}: holds no two numbers in any of {', '.join(CHANNELS)}")
    session = recording.source.session
    rounded = session is not None and session.metadata.source == "import"
    series = even_channels(samples["device_time_ns"], samples["segment"], channels, rounded=rounded)
    if len(samples) < FEWEST_SAMPLES:
        raise bad_data(
            f"{path}: has {len(samples)} samples; an Allan deviation needs {FEWEST_SAMPLES} at the least",
            "record for ten times as long as the longest averaging time of interest",
        )
    for name in channels:
        used = series[name].used / series[name].samples if name in series else 0.0
        if used < LEAST_USED:
            raise bad_data(
                f"{path}: {name}: only {used:.0%} of the samples are known to come at an even rate",
                "nothing is resampled: that would change the noise that is to be measured.  "
                "Use the device's own time or counter; imumon import takes rate_hz for rows that are even",
            )
        if series[name].rate_hz > FASTEST_HZ:
            raise bad_data(
                f"{path}: by device_time_ns the rate is {series[name].rate_hz:.3g} Hz",
                "the column must hold nanoseconds; imumon import takes times in other units",
            )
    warnings = recording.warnings()
    if empty := [name for name in there if name not in channels]:
        warnings.append(f"{', '.join(empty)}: fewer than two numbers; left out")
    of_grids = by_text((name, text) for name, channel in series.items() for text in _of_grid(channel))
    for text, alike in of_grids.items():
        warnings.append(text if len(alike) == len(series) else f"{', '.join(alike)}: {text}")
    warnings += _of_motion(samples, declared="at_rest" in stated)
    length_s = max(channel.duration_s for channel in series.values())
    if length_s < SHORT_S:
        advice = "record for ten times the longest averaging time of interest, such as an hour"
        warnings.append(f"{length_s:.3g} s are too short for bias instability and drift: {advice}")
    return Channels(series, [*warnings, *_of_temperature(samples)])


def by_text(found: Iterable[tuple[str, str]]) -> dict[str, list[str]]:
    """Return pairs of a channel and a text as the channels of each text."""
    channels: dict[str, list[str]] = {}
    for channel, text in found:
        channels.setdefault(text, []).append(channel)
    return channels


def _of_grid(channel: EvenSeries) -> Iterator[str]:
    """Yield gaps, pieces and uneven times of a channel."""
    lost, pieces = int(channel.gap_lengths.sum()), len(channel.islands) - 1
    odd, rate = channel.samples - channel.used, f"{channel.rate_hz:.6g} Hz"
    if lost:
        how = f"their neighbours' mean in averaging times {PARTS} times as long, crossed by no shorter one"
        yield f"{len(channel.gap_lengths):,} gaps, {lost:,} of {len(channel.values):,} samples missing: {how}"
    if pieces > 1:
        what = "nothing crosses (restarts, long or uneven gaps): the longest limits the averaging time"
        yield f"{pieces} pieces that {what}"
    if odd:
        what = f"do not come at the even rate of {rate} and are left out"
        yield f"{odd:,} of {channel.samples:,} samples {what}"
    if channel.jitter > MOST_JITTER:
        yield f"time from sample to sample varies by {channel.jitter:.0%} rms; taken as even"


def _of_motion(samples: SampleBlock, *, declared: bool) -> Iterator[str]:
    """Yield the share of motion: by the column ``at_rest`` of a table, else by the rest detector."""
    time_ns = samples["device_time_ns"]
    known = time_ns >= time_ns[0] + LEAST_FOR_MOTION_S * 1e9
    if "at_rest" not in samples:
        return
    if not (known.any() or declared):
        yield f"whether the unit was at rest is unknown: that takes {LEAST_FOR_MOTION_S:.0f} s"
        return
    at_rest = samples["at_rest"] == 1
    first = np.argmax(at_rest | known)  # until the first rest nothing is known, unless it comes late
    share = np.mean(~at_rest[first:])
    if share <= MOVING_SHARE:
        return
    advice = "these are deviations of the motion, not of the sensor: record it lying still"
    if declared:
        yield f"the unit moved during {share:.1%} of the recording (column at_rest): {advice}"
    elif not at_rest.any():
        what = "motion, more noise than a sensor at rest can have, or steps that are too coarse"
        yield f"the rest detector found no rest: {what}; {advice}"
    else:
        yield f"the unit moved during {share:.1%} of the recording (by the rest detector): {advice}"


def _of_temperature(samples: SampleBlock) -> Iterator[str]:
    there = (samples[name][np.isfinite(samples[name])] for name in TEMPERATURES if name in samples)
    readings = next((part for part in there if len(part)), None)
    if readings is None:
        what = "thermal drift cannot be distinguished from bias instability and random walk"
        yield f"there is no temperature: {what}"
        return
    low, high = np.percentile(readings, [0.5, 99.5])
    if high - low > WARMING_DEGC:
        what = "bias instability, random walk and ramp hold thermal drift"
        yield f"the temperature moved between {low:.1f} and {high:.1f} °C: {what}"


def group_of(channel: str) -> str:
    """Return the sensor of a channel: "gyro" or "accel"."""
    return channel.rsplit("_", 1)[0]
