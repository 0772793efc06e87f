"""The numbers of P(turn) that docs/rest-detector.md and its details work through."""

from __future__ import annotations

import math

import numpy as np
import pytest

from imumon.estimation.rest.odds import of_changed_bias, of_nominal_bias
from imumon.estimation.rest.parameters import RestParameters
from imumon.geodesy import DEG_PER_H

LARGEST = RestParameters().largest_jump


def by_gyros(dph: float, changes: int = 0) -> float:
    """Return P(turn) of a rate that differs from a well-known bias, deg/h, by the gyros alone."""
    size = dph * DEG_PER_H
    return 1.0 / (1.0 + of_changed_bias(size, changes, LARGEST) + of_nominal_bias(size, DEG_PER_H**2))


@pytest.mark.parametrize(("dph", "odds", "p", "added"), [(1800.0, 0.18, 0.85, 707), (180.0, 1.76, 0.36, 108)])
def test_the_events_of_the_figure(dph: float, odds: float, p: float, added: int) -> None:
    p_turn = by_gyros(dph)
    assert round(of_changed_bias(dph * DEG_PER_H, 0, LARGEST), 2) == odds
    assert round(p_turn, 2) == p
    assert round(dph * math.sqrt(min(p_turn, 1.0 - p_turn))) == added


@pytest.mark.parametrize(("dph", "p"), [(22.0, 0.1), (99.0, 0.25), (324.5, 0.5)])
def test_below_this_a_turn_is_bias_and_below_that_it_is_rest(dph: float, p: float) -> None:
    assert by_gyros(dph - 1.0) < p < by_gyros(dph + 1.0)
    assert by_gyros(dph - 1.0, changes=1) > p


def test_a_changed_bias_alone_leaves_a_turn_possible() -> None:
    largest = max(of_changed_bias(dph * DEG_PER_H, 0, LARGEST) for dph in np.arange(36.0, 3500.0))
    assert round(largest, 1) == 6.2
    assert round(1.0 / (1.0 + largest), 2) == 0.14
    assert by_gyros(9.0) < 0.05 < by_gyros(9.5)


def test_after_an_earlier_change_a_turn_is_likelier() -> None:
    found = [by_gyros(dph, changes=1) for dph in (9, 22, 36, 99, 180, 324, 1800)]
    assert np.round(found, 2).tolist() == [0.09, 0.18, 0.24, 0.4, 0.53, 0.67, 0.92]
