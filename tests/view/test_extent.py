"""The vertical axis: three numbers or more, the band inside, digits not magnified."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imumon.view.extent import FEW_MARKS, FEWEST_MARKS, Extent, Reach, round_ends

SECOND = 1_000_000_000


def _clock(second: int) -> np.ndarray[tuple[int], np.dtype[np.int64]]:
    return np.array([second * SECOND])


def _reach(values: list[float], half: float = 0.0, **more: float) -> Reach:
    column = np.array(values)[:, np.newaxis]
    return Reach(column, np.full_like(column, half), **more)


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6))
def test_round_ends_leave_room_for_three_numbers_and_hold_the_data(low: float, span: float) -> None:
    first, last = round_ends(low, low + span, FEW_MARKS)
    slack = 1e-6 * max(abs(low), abs(low + span), span)
    assert first <= low + slack
    assert last >= low + span - slack
    marks = [
        round((last - first) / 10.0**power)
        for power in range(-20, 20)
        if math.isclose((last - first) / 10.0**power, round((last - first) / 10.0**power), rel_tol=1e-6)
    ]
    assert any(2 <= count <= FEW_MARKS for count in marks)


def test_a_band_is_inside_and_one_spike_of_it_is_not() -> None:
    extent = Extent()
    for second in range(10):
        ends = extent.ends(_clock(second), _reach([1.0], 0.5))
        assert ends == pytest.approx((0.5, 1.5))
    ends = extent.ends(_clock(11), _reach([1.0], 500.0))
    assert ends is not None
    assert ends[1] == pytest.approx(1.0 + 4 * 0.5)


def test_a_quantized_column_at_rest_spans_its_steps() -> None:
    extent = Extent()
    values = [20.0] * 50 + [20.0625] * 50
    ends = extent.ends(_clock(1), _reach(values))
    assert ends is not None
    assert ends[1] - ends[0] == pytest.approx(4 * 0.0625)


def test_what_is_counted_begins_at_zero() -> None:
    assert Extent().ends(_clock(1), _reach([0.0], least=4.0, floor=0.0), FEWEST_MARKS) == (0.0, 20.0)


def test_one_point_a_second_and_none_without_a_value() -> None:
    extent = Extent()
    assert extent.ends(_clock(1), _reach([math.nan])) is None
    assert extent.ends(_clock(1), _reach([1.0, 2.0])) is not None
    assert extent.ends(_clock(1), _reach([5.0])) is None
    assert extent.ends(_clock(2), _reach([1.0])) == (1.0, 5.0)
