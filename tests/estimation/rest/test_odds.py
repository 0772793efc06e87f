"""The numbers of P(turn) that docs/rest-detector.md and its details work through."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imumon.estimation.rest.odds import SteadyRate, changed_bias, probability_of_turn
from imumon.estimation.rest.parameters import RestParameters
from imumon.estimation.rest.slots import Measurement
from imumon.geodesy import DEG_PER_H
from tests.estimation.rest.scenes import GRAVITY

LIMITS = RestParameters()


def rate(dph: float, changes: int = 0) -> SteadyRate:
    """Return a rate about the vertical that differs from a well-known bias, deg/h."""
    unknown, change = np.full(3, np.nan), np.array([0.0, 0.0, dph * DEG_PER_H])
    force, variance = np.array([0.0, 0.0, GRAVITY]), np.full(3, DEG_PER_H**2)
    measured = [Measurement(float(s), 1.0, change, force, unknown, unknown) for s in range(3)]
    return SteadyRate(measured, np.zeros(3), variance, change, variance, changes, 3.0, None, 1e-6)


@pytest.mark.parametrize(("dph", "odds", "p", "added"), [(1800.0, 0.18, 0.85, 707), (180.0, 1.76, 0.36, 108)])
def test_the_events_of_the_figure(dph: float, odds: float, p: float, added: int) -> None:
    p_turn = probability_of_turn(rate(dph), LIMITS)
    assert round(changed_bias(rate(dph), LIMITS.largest_jump), 2) == odds
    assert round(p_turn, 2) == p
    assert round(dph * math.sqrt(min(p_turn, 1.0 - p_turn))) == added


@pytest.mark.parametrize(("dph", "p"), [(22.0, 0.1), (99.0, 0.25), (324.5, 0.5)])
def test_below_this_a_turn_is_bias_and_below_that_it_is_rest(dph: float, p: float) -> None:
    below, above = (probability_of_turn(rate(dph + one), LIMITS) for one in (-1.0, 1.0))
    assert below < p < above
    assert probability_of_turn(rate(dph - 1.0, changes=1), LIMITS) > p


def test_a_changed_bias_alone_leaves_a_turn_possible() -> None:
    largest = max(changed_bias(rate(dph), LIMITS.largest_jump) for dph in np.arange(36.0, 3500.0))
    assert round(largest, 1) == 6.2
    assert round(1.0 / (1.0 + largest), 2) == 0.14
    assert probability_of_turn(rate(9.0), LIMITS) < 0.05 < probability_of_turn(rate(9.5), LIMITS)


def test_after_an_earlier_change_a_turn_is_likelier() -> None:
    found = [probability_of_turn(rate(dph, changes=1), LIMITS) for dph in (9, 22, 36, 99, 180, 324, 1800)]
    assert np.round(found, 2).tolist() == [0.09, 0.18, 0.24, 0.4, 0.53, 0.67, 0.92]
