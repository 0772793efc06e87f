"""The vertical axis: the band inside, little else, digits not magnified."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imumon.view.extent import REMEMBERED, Extent, Reach

SECOND = 1_000_000_000


def _clock(second: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    return np.array([second * SECOND])


def _reach(values: list[float], half: float = 0.0, **more: float) -> Reach:
    column = np.array(values)[:, np.newaxis]
    return Reach(column, np.full_like(column, half), **more)


def test_a_band_is_inside_and_one_spike_of_it_is_not() -> None:
    extent = Extent()
    for second in range(10):
        ends = extent.ends(_clock(second), _reach([1.0], 0.5))
        assert ends == pytest.approx((0.4, 1.6))
    ends = extent.ends(_clock(11), _reach([1.0], 500.0))
    assert ends == pytest.approx((0.4, 1.6))


def test_one_spike_of_a_line_does_not_stretch_its_axis_and_a_burst_does() -> None:
    noise = np.random.default_rng(7).normal(size=(30, 100))
    calm, spiky, burst = Extent(), Extent(), Extent()
    for second in range(30):
        loud = noise[second].copy()
        loud[50] += 1e4 if second == 10 else 0.0
        calm_ends = calm.ends(_clock(second), _reach(list(noise[second])))
        spiky_ends = spiky.ends(_clock(second), _reach(list(loud)))
        loud[51] += 1e4 if second == 10 else 0.0
        burst_ends = burst.ends(_clock(second), _reach(list(loud)))
    assert calm_ends is not None
    assert spiky_ends is not None
    assert burst_ends is not None
    assert calm_ends[1] >= noise.max(), "noise is no spike"
    assert spiky_ends[1] < 20 * noise.max()
    assert burst_ends[1] > 1e4


def test_an_axis_is_at_most_half_as_long_again_as_its_data() -> None:
    for low, high in ((10.0, 690.0), (-201.0, 549.0), (-4.5e5, 4.5e5)):
        ends = Extent().ends(_clock(0), _reach(list(np.linspace(low, high, 100))))
        assert ends is not None
        assert ends[0] < low < high < ends[1]
        assert ends[1] - ends[0] < 1.5 * (high - low)


def test_a_band_that_was_wide_at_first_is_cut_off_once_it_is_known_to_be_narrow() -> None:
    extent = Extent()
    for second in range(40):
        ends = extent.ends(_clock(second), _reach([1.0], 100.0 if second < 10 else 1.0))
    assert ends is not None
    assert ends[1] < 10.0


def test_what_has_left_the_window_does_not_count() -> None:
    extent = Extent(window_s=10.0)
    extent.ends(_clock(0), _reach([1000.0]))
    for second in range(1, 30):
        ends = extent.ends(_clock(second), _reach([float(second % 2)]))
    assert ends == pytest.approx((-0.1, 1.1))


def test_a_long_recording_is_remembered_in_bounded_memory() -> None:
    extent = Extent()
    for second in range(2 * REMEMBERED + 10):
        ends = extent.ends(_clock(second), _reach([5.0 if second in (7, 8) else 1.0], 0.5))
    assert ends is not None
    assert ends[1] > 5.4


def test_a_zero_that_never_changes_has_an_axis_with_numbers() -> None:
    ends = Extent().ends(_clock(0), _reach([0.0, 0.0], least=0.04))
    assert ends == pytest.approx((-0.024, 0.024))


def test_a_quantized_column_at_rest_spans_its_steps() -> None:
    extent = Extent()
    values = [20.0] * 50 + [20.0625] * 50
    ends = extent.ends(_clock(1), _reach(values))
    assert ends is not None
    assert ends[1] - ends[0] == pytest.approx(4 * 0.0625 * 1.2)


def test_what_is_counted_begins_at_zero() -> None:
    ends = Extent().ends(_clock(1), _reach([0.0], least=4.0, floor=0.0))
    assert ends is not None
    assert ends[0] == 0.0
    assert 4.0 <= ends[1] < 5.0


def test_one_point_a_second_and_none_without_a_value() -> None:
    extent = Extent()
    assert extent.ends(_clock(1), _reach([math.nan])) is None
    assert extent.ends(_clock(1), _reach([1.0, 2.0])) is not None
    assert extent.ends(_clock(1), _reach([5.0])) is None
    assert extent.ends(_clock(2), _reach([1.0])) == pytest.approx((0.6, 5.4))


@pytest.mark.parametrize("ends", [(-1e306, 1e306), (0.0, 1e308), (1e306, 1e306)])
def test_ends_beyond_all_measurements_are_numbers(ends: tuple[float, float]) -> None:
    found = Extent().ends(_clock(0), _reach(list(ends)))
    assert found is not None
    assert np.isfinite(found).all()
    assert found[0] < found[1]
