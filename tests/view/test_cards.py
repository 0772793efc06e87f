"""The present values as a person writes them down."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from imumon.view.cards import Cards, Reading, card, measured


@pytest.mark.parametrize(
    ("value", "sd", "text"),
    [
        (30.00123, 0.0123, "30.001 ± 0.012"),
        (963.7, 33.2, "964 ± 33"),
        (963.7, 332.0, "960 ± 330"),
        (-12.3456, 9.96, "-12 ± 10"),
        (1.0, math.nan, "1"),
        (math.nan, 1.0, "–"),
        (1.5, 0.0, "1.5"),
        (0.0, 1e-12, "0.000000000 ± 0.000000000"),
    ],
)
def test_a_value_has_the_digits_that_its_sigma_allows(value: float, sd: float, text: str) -> None:
    assert measured(value, sd) == text


@given(st.floats(-1e6, 1e6), st.floats(1e-6, 1e6))
def test_what_is_written_is_within_a_twentieth_of_sigma(value: float, sd: float) -> None:
    written, _, spread = measured(value, sd).partition(" ± ")
    assert abs(float(written) - value) <= 0.051 * sd
    assert float(spread) == pytest.approx(sd, rel=0.06)


GYRO = [Reading("rate", axis, f"gyro_{axis}", None, "°/s", 10.0) for axis in "xyz"]
HEADING = Reading("heading", "shown", "heading", "heading_sd", "°", 1.0, headline=True)


def test_single_samples_are_averaged_and_of_an_estimate_the_last_counts() -> None:
    cards = Cards()
    for values in ([1.0, 2.0, np.nan], [3.0]):
        columns = {f"gyro_{axis}": np.array(values) for axis in "xyz"}
        estimate = {"heading": np.array(values), "heading_sd": np.full(len(values), 0.1)}
        cards.add([*GYRO, HEADING], columns | estimate)
    text = card([*GYRO, HEADING], cards.take())
    assert "| **rate** | 20.000 | 20.000 | 20.000 | °/s |" in text
    assert text.startswith("# 3.00 ± 0.10°")
    assert "| **heading** | 3.00 ± 0.10 | | | ° |" in text


def test_what_was_shown_stays_until_something_new_comes() -> None:
    cards = Cards()
    cards.add([HEADING], {"heading": np.array([7.0]), "heading_sd": np.array([0.5])})
    assert cards.take()["heading"] == 7.0
    cards.add([HEADING], {"heading": np.array([np.nan]), "heading_sd": np.array([np.nan])})
    assert cards.take()["heading"] == 7.0
