"""The spectrum against what was put in: the density of white noise, the frequency and rms of a line."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import SampleBlock
from imumon.estimation.spectrum.stage import LiveSpectrum, peaks, welch


@pytest.mark.parametrize("rate", [20.0, 100.0, 1000.0])
def test_white_noise_has_its_density_and_its_power(rate: float) -> None:
    values = np.random.default_rng(1).normal(0.0, 0.3, int(40 * rate))
    frequency, density, _ = welch(values, 1.0 / rate, len(values) // 7 * 2)
    assert density[1:-1].mean() == pytest.approx(2 * 0.09 / rate, rel=0.1)
    assert density.sum() * frequency[1] == pytest.approx(values.var(), rel=0.1)


@pytest.mark.parametrize(("frequency", "amplitude"), [(3.3, 0.05), (17.77, 0.2), (49.1, 0.02)])
def test_a_line_is_named_where_it_is(frequency: float, amplitude: float) -> None:
    t = np.arange(0.0, 30.0, 0.01)
    noise = np.random.default_rng(2).normal(0.0, 0.02, len(t))
    ((at, rms), *_) = peaks(*welch(amplitude * np.sin(2 * np.pi * frequency * t) + noise, 0.01, 856))
    assert at == pytest.approx(frequency, abs=0.05)
    assert rms == pytest.approx(amplitude / np.sqrt(2), rel=0.15)


def test_noise_alone_hardly_ever_makes_a_line() -> None:
    generator = np.random.default_rng(3)
    seen = [bool(peaks(*welch(generator.normal(size=3000), 0.01, 856))) for _ in range(300)]
    assert sum(seen) <= 15  # 1 % are allowed; a median over 31 bins is not the floor itself


def test_red_noise_makes_no_line_either() -> None:
    generator = np.random.default_rng(4)
    walks = [np.cumsum(generator.normal(size=3000)) for _ in range(100)]
    assert sum(bool(peaks(*welch(walk, 0.01, 856))) for walk in walks) <= 5


def _block(first: int, n: int, segment: int = 0, frequency: float = 12.0) -> SampleBlock:
    time = np.arange(first, first + n) * 10_000_000
    shake = 0.01 * np.sin(2 * np.pi * frequency * time * 1e-9)
    noise = np.random.default_rng(first).normal(0.0, 1e-3, n)
    columns = {"device_time_ns": time, "segment": np.full(n, segment), "gyro_z": shake + noise}
    return SampleBlock(columns)


def test_the_chart_names_the_line_whatever_the_blocks() -> None:
    texts = []
    for size in (7, 100, 2900):
        stage = LiveSpectrum()
        for first in range(0, 2900, size):
            stage.process(_block(first, min(size, 2900 - first)))
        (chart,) = stage.charts()
        assert chart.place == "Spectrum"
        texts.append(chart.notes[0].split(":")[0])
    assert set(texts) == {"z  12 Hz"}


def test_a_restart_of_the_device_begins_anew() -> None:
    stage = LiveSpectrum()
    stage.process(_block(0, 1000))
    stage.process(_block(1000, 100, segment=1))
    assert stage.charts() == []
    stage.process(_block(1100, 1000, segment=1, frequency=30.0))
    assert stage.charts()[0].notes[0].startswith("z  30 Hz")


def test_lost_packets_are_bridged_and_a_long_gap_is_not() -> None:
    stage = LiveSpectrum()
    whole = _block(0, 1500)
    stage.process(whole.rows(0, 500))
    stage.process(whole.rows(503, 1500))
    assert stage.charts()[0].notes[0].startswith("z  12 Hz")
    stage.process(_block(3000, 100))
    assert stage.charts() == []


def test_memory_is_bounded() -> None:
    stage = LiveSpectrum()
    for first in range(0, 100_000, 1000):
        stage.process(_block(first, 1000))
    assert len(stage.charts()[0].curves[0].x) < 1000
