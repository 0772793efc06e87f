"""The device's clock as a channel: a simulated crystal over temperature, heard through a jittering host."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import cache

import numpy as np
import pytest
from scipy.signal import lfilter

from imumon.blocks import FloatArray, SampleBlock
from imumon.clock.channel import CLOCK, with_delay
from imumon.lab.diagnosis.blocks import make_blocks, white_floor
from imumon.lab.diagnosis.diagnose import diagnose
from imumon.lab.diagnosis.runs import Run, collect, unit_of
from tests.lab.diagnosis.units import ramps

RATE_HZ = 20
SECONDS = 4000
UNIX_NS = 1_767_225_600_000_000_000
PARABOLA_PPM = -0.034
"""Per °C², of a tuning-fork crystal about 25 °C."""
FRAME_NS = 1_000_000
WAKE_UP_NS = 100_000.0
Crystal = Callable[[FloatArray], FloatArray]
"""Rate in ppm, from the temperature of each second."""


def parabola(temperature: FloatArray) -> FloatArray:
    return 20.0 + PARABOLA_PPM * (temperature - 25.0) ** 2


def late_parabola(temperature: FloatArray) -> FloatArray:
    """Return that of a crystal which is 300 s behind the thermometer, with a slope of 2 ppm/°C."""
    decay = np.exp(-1.0 / 300.0)
    late = lfilter([1 - decay], [1.0, -decay], temperature, zi=[decay * temperature[0]])[0]
    return np.asarray(parabola(temperature) + 2.0 * (late - 25.0))


def heard(seed: int, up: bool, crystal: Crystal, held: bool = False) -> Iterator[SampleBlock]:
    """Yield samples with device times of the crystal, read by a host that polls every millisecond."""
    random = np.random.default_rng(seed)
    seconds, temperature = ramps(SECONDS, up)
    n = SECONDS * RATE_HZ
    true_s = np.arange(n) / RATE_HZ
    ppm = np.interp(true_s, seconds, crystal(temperature))
    device_ns = np.cumsum(np.round((1.0 + ppm * 1e-6) / RATE_HZ * 1e9)).astype(np.int64)
    frame = -(-(true_s * 1e9).astype(np.int64) // FRAME_NS) * FRAME_NS
    delay = random.exponential(WAKE_UP_NS, n)
    delay[n // 3 : n // 3 + RATE_HZ // 2] += 4e8  # half a second in which nobody read
    arrival_ns = UNIX_NS + np.maximum.accumulate(frame + delay.astype(np.int64))
    columns = {
        "device_time_ns": arrival_ns if held else device_ns,
        "arrival_time_ns": arrival_ns,
        "segment": np.zeros(n, np.int64),
        "temperature": np.interp(true_s, seconds, temperature) + 0.02 * random.standard_normal(n),
        "gyro_x": 1e-3 * random.standard_normal(n),
    }
    block = SampleBlock(columns)
    for start in range(0, n, 7001):
        yield block.rows(start, min(start + 7001, n))


@cache
def runs(crystal: Crystal) -> list[Run]:
    return [collect(with_delay(heard(at, at != 1, crystal)), f"run {at}", (CLOCK,))[0] for at in range(3)]


def test_a_crystals_parabola_is_the_curve_of_the_clock_and_nothing_else_is_missing() -> None:
    three = runs(parabola)

    (verdict,) = diagnose(three[:2], three[2:], sensors=(CLOCK,)).verdicts

    scale = verdict.channel.scale
    assert not verdict.claims
    assert not verdict.unexplained
    assert unit_of(verdict.name) == "ppm"
    assert verdict.before.declared[2] / scale.half_span**2 == pytest.approx(PARABOLA_PPM, rel=0.15)
    assert verdict.before.declared[0] == pytest.approx(parabola(np.array([scale.middle]))[0], abs=0.5)


def test_the_floor_is_what_the_delays_make_of_a_block() -> None:
    three = runs(late_parabola)
    blocks = [make_blocks(run, [CLOCK], ["temperature"]) for run in three]
    floor = white_floor(CLOCK, blocks).sd
    errors = []
    for at, found in enumerate(blocks):
        truth = late_parabola(ramps(SECONDS, at != 1)[1])
        inside = found.time_s[:-1].astype(int) // 30
        errors.append(
            found.mean[CLOCK][:-1] - truth[: SECONDS // 30 * 30].reshape(-1, 30).mean(axis=1)[inside]
        )
    rms = float(np.sqrt(np.mean(np.concatenate(errors) ** 2)))
    assert 0.8 * rms < floor < 1.3 * rms
    assert rms < 0.5


def test_a_crystal_that_is_late_is_named_with_its_time_constant() -> None:
    three = runs(late_parabola)
    (verdict,) = diagnose(three[:2], three[2:], sensors=(CLOCK,)).verdicts
    (claim,) = verdict.claims
    assert claim.finding.name == "thermal_lag"
    assert claim.parts[0].effect.model_dump()["time_constant_s"] == pytest.approx(300.0, rel=0.1)


def test_without_arrivals_of_its_own_there_is_no_clock() -> None:
    held = collect(with_delay(heard(1, True, parabola, held=True)), "held", (CLOCK,))[0]
    assert CLOCK not in held.mean
    known = runs(parabola)
    diagnosis = diagnose(known[:2], [held], sensors=("gyro", CLOCK))
    assert [verdict.name for verdict in diagnosis.verdicts] == ["gyro_x"]
