"""Rest told again from both sides of a pause: what is filled, and what is not."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import BoolArray, FloatArray
from imumon.recordings.hindsight import LONGEST, rest_in_hindsight

N, SD = 400, 1e-3
DRIFT = np.array([1e-5, 1e-5])


def told(pause: slice, mean: FloatArray, loud: slice | None = None, cut: int | None = None) -> BoolArray:
    rest = np.ones(N, np.bool_)
    rest[pause] = False
    variance = np.full((N, 2), 1e-6)
    if loud is not None:
        variance[loud] = 1e-4
    run = np.zeros(N, np.int64)
    if cut is not None:
        run[cut:] = 1
    return rest_in_hindsight(rest, run, mean, variance, DRIFT)


@pytest.fixture
def drifting() -> FloatArray:
    """Two sensors that drift by ten sigma of a slot in each hundred."""
    noise = np.random.default_rng(5).normal(0.0, SD, (N, 2))
    return np.asarray(noise + np.linspace(0.0, 40 * SD, N)[:, np.newaxis])


@pytest.mark.parametrize("pause", [slice(0, 15), slice(200, 216), slice(390, N)])
def test_a_pause_that_lies_on_the_line_was_rest(drifting: FloatArray, pause: slice) -> None:
    assert told(pause, drifting).all()


def test_a_turn_in_the_pause_was_none(drifting: FloatArray) -> None:
    drifting[205:208, 1] += 20 * SD
    assert not told(slice(200, 216), drifting)[200:216].any()


def test_another_pose_after_the_pause_was_none(drifting: FloatArray) -> None:
    drifting[208:] += 1.0
    assert not told(slice(200, 216), drifting)[200:216].any()


def test_a_loud_pause_was_none(drifting: FloatArray) -> None:
    assert not told(slice(200, 216), drifting, loud=slice(210, 211))[200:216].any()


def test_a_long_pause_and_one_between_runs_are_left(drifting: FloatArray) -> None:
    assert not told(slice(100, 101 + LONGEST), drifting)[100 : 101 + LONGEST].any()
    assert not told(slice(0, 15), drifting, cut=15)[:15].any()


def test_rest_is_never_taken_back(drifting: FloatArray) -> None:
    drifting[50] += 1.0
    assert told(slice(200, 216), drifting)[:200].all()
