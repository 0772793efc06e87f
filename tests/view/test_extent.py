"""The vertical axis: three numbers or more, the band inside, digits not magnified."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from support.picture_faults import numbers_on

from imumon.view.extent import REMEMBERED, Extent, Reach, marks_of, with_marks
from imumon.view.items import WEB_TAB

SECOND = 1_000_000_000
MANY = 30
"""Marks that have room in a high strip."""


def _clock(second: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    return np.array([second * SECOND])


def _reach(values: list[float], half: float = 0.0, **more: float) -> Reach:
    column = np.array(values)[:, np.newaxis]
    return Reach(column, np.full_like(column, half), **more)


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6), st.floats(3, 40))
def test_three_whole_numbers_have_room_on_every_axis_and_it_holds_the_data(
    low: float, span: float, most: float
) -> None:
    first, last = with_marks(low, low + span, most)
    slack = 1e-6 * span + 1e-12 * abs(low)
    assert first <= low + slack
    assert last >= low + span - slack
    assert numbers_on(first, last, most) >= 3


def test_a_band_is_inside_and_one_spike_of_it_is_not() -> None:
    extent = Extent()
    for second in range(10):
        ends = extent.ends(_clock(second), _reach([1.0], 0.5), MANY)
        assert ends == pytest.approx((0.4, 1.6))
    ends = extent.ends(_clock(11), _reach([1.0], 500.0), MANY)
    assert ends == pytest.approx((0.4, 1.6))


def test_one_spike_of_a_line_does_not_stretch_its_axis_and_a_burst_does() -> None:
    noise = np.random.default_rng(7).normal(size=(30, 100))
    calm, spiky, burst = Extent(), Extent(), Extent()
    for second in range(30):
        loud = noise[second].copy()
        loud[50] += 1e4 if second == 10 else 0.0
        calm_ends = calm.ends(_clock(second), _reach(list(noise[second])), MANY)
        spiky_ends = spiky.ends(_clock(second), _reach(list(loud)), MANY)
        loud[51] += 1e4 if second == 10 else 0.0
        burst_ends = burst.ends(_clock(second), _reach(list(loud)), MANY)
    assert calm_ends is not None
    assert spiky_ends is not None
    assert burst_ends is not None
    assert calm_ends[1] >= noise.max(), "noise is no spike"
    assert spiky_ends[1] < 20 * noise.max()
    assert burst_ends[1] > 1e4


def test_where_room_would_cost_the_finer_marks_there_is_less_of_it() -> None:
    ends = Extent().ends(_clock(0), _reach([10.0, 690.0]), 7)
    assert ends is not None
    assert ends[0] > -100.0
    assert ends[1] < 800.0


def test_a_band_that_was_wide_at_first_is_cut_off_once_it_is_known_to_be_narrow() -> None:
    extent = Extent()
    for second in range(40):
        ends = extent.ends(_clock(second), _reach([1.0], 100.0 if second < 10 else 1.0), MANY)
    assert ends is not None
    assert ends[1] < 10.0


def test_what_has_left_the_window_does_not_count() -> None:
    extent = Extent(window_s=10.0)
    extent.ends(_clock(0), _reach([1000.0]), MANY)
    for second in range(1, 30):
        ends = extent.ends(_clock(second), _reach([float(second % 2)]), MANY)
    assert ends == pytest.approx((-0.1, 1.1))


def test_a_long_recording_is_remembered_in_bounded_memory() -> None:
    extent = Extent()
    for second in range(2 * REMEMBERED + 10):
        ends = extent.ends(_clock(second), _reach([5.0 if second in (7, 8) else 1.0], 0.5), MANY)
    assert ends is not None
    assert ends[1] > 5.4


def test_a_zero_that_never_changes_has_an_axis_with_numbers() -> None:
    ends = Extent().ends(_clock(0), _reach([0.0, 0.0], least=0.04), MANY)
    assert ends == pytest.approx((-0.024, 0.024))


def test_a_quantized_column_at_rest_spans_its_steps() -> None:
    extent = Extent()
    values = [20.0] * 50 + [20.0625] * 50
    ends = extent.ends(_clock(1), _reach(values), MANY)
    assert ends is not None
    assert ends[1] - ends[0] == pytest.approx(4 * 0.0625 * 1.2)


def test_what_is_counted_begins_at_zero() -> None:
    ends = Extent().ends(_clock(1), _reach([0.0], least=4.0, floor=0.0), 30)
    assert ends is not None
    assert -0.1 < ends[0] < 0.0, "room for half of its number"
    assert 4.0 <= ends[1] < 5.0


def test_one_point_a_second_and_none_without_a_value() -> None:
    extent = Extent()
    assert extent.ends(_clock(1), _reach([math.nan]), MANY) is None
    assert extent.ends(_clock(1), _reach([1.0, 2.0]), MANY) is not None
    assert extent.ends(_clock(1), _reach([5.0]), MANY) is None
    assert extent.ends(_clock(2), _reach([1.0]), MANY) == pytest.approx((0.6, 5.4))


@pytest.mark.parametrize("ends", [(-1e306, 1e306), (0.0, 1e308), (1e306, 1e306)])
def test_ends_beyond_all_measurements_are_numbers(ends: tuple[float, float]) -> None:
    low, high = with_marks(*ends, 3)
    assert np.isfinite([low, high]).all()
    assert low < high


def test_a_part_of_a_step_counts_as_room() -> None:
    low, high = with_marks(-5.0, 405.0, marks_of(4, WEB_TAB))
    assert (low, high) == (-5.0, 405.0), "four steps of 100 and a bit more have room in each of four strips"
