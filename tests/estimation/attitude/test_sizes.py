from __future__ import annotations

import numpy as np
import pytest

from imumon.estimation.attitude.sizes import Look, OnBody, Sizes, usual


def test_doubt_is_in_the_mean_square_until_something_is_seen() -> None:
    sizes = usual(0.01, [0.8], 0.1)
    assert sizes.usual == pytest.approx(0.9)
    assert sizes.mean_square[0] == pytest.approx(0.9 * 1e-4 + 0.025 * sizes.squares[0, 1:].sum())
    agrees = sizes.seen(0.01**2, 0.005**2, sizes.squares, 2)
    assert agrees.usual > 0.99
    assert np.sqrt(agrees.mean_square[0]) < 0.02
    contradicts = sizes.seen(2 * 0.5**2, 0.005**2, sizes.squares, 2)
    assert contradicts.usual < 1e-6
    assert 0.2 < np.sqrt(contradicts.mean_square[0]) < 0.8


@pytest.mark.parametrize("true", [0.01, 0.09, 0.8])
def test_the_size_that_errors_were_drawn_from_is_found(true: float) -> None:
    rng, sizes = np.random.default_rng(3), usual(0.01, [0.8, 0.8], 0.1)
    for _ in range(40):
        gain = rng.uniform(0.0, 1.0, 2)
        off = rng.normal(0.0, np.sqrt(gain @ [true**2, 0.01**2] + 0.001**2), 2)
        sizes = sizes.seen(float(off @ off), 0.001**2, sizes.squares * gain[:, np.newaxis], 2)
    found = np.sqrt(sizes.mean_square)
    assert 0.5 < found[0] / true < 2.0
    assert 0.5 < found[1] / 0.01 < 2.0


def test_what_has_no_size_is_nothing() -> None:
    assert usual(0.0, [0.0, 0.0, 0.0], 0.1).mean_square.tolist() == [0.0] * 3
    assert isinstance(usual(0.5, [0.1], 0.1), Sizes)  # as large as declared, if that is more


UNDISTURBED = Look(0.01**2, 0.01**2)


def test_looks_from_one_direction_count_once_and_from_others_again() -> None:
    vector = OnBody.of(usual(0.01, [0.8], 0.1))
    east, north, up = np.eye(3)
    vector.look(east, UNDISTURBED)
    once = vector.sd
    for _ in range(100):
        vector.look(east, UNDISTURBED)
    assert vector.sd == once < 0.1
    vector.look(north, UNDISTURBED)
    vector.look(up, UNDISTURBED)
    assert vector.sd < 0.02


@pytest.mark.parametrize("across", [True, False])
def test_what_comes_after_many_looks_is_believed_at_once_where_it_may_come(across: bool) -> None:
    """A magnet in the direction of the field, or across: the strength shows one, the heading the other."""
    found = []
    for changed in (0.0, 1e-4):
        vector = OnBody.of(usual(0.01, [0.8], 0.1))
        for direction in (*np.eye(3), *-np.eye(3)):
            vector.look(direction, UNDISTURBED, changed=changed)
        assert vector.sd < 0.02
        off = Look(0.3**2, 0.01**2)
        if across:
            vector.look(-np.eye(3)[2], UNDISTURBED, off, changed)
        vector.look(-np.eye(3)[2], UNDISTURBED if across else off, changed=changed)  # what was across stays
        found.append(vector.sd)
    assert found[0] < found[1]
    assert 0.2 < found[1] < 0.8
