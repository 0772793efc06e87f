from __future__ import annotations

import numpy as np
import pytest

from imumon.blocks import FloatArray
from imumon.simulation.unit.noise import GaussMarkov, RandomWalk, White, generator


def allan(values: FloatArray, rate_hz: float, tau_s: float) -> float:
    import allantools  # takes a second, which not every process of the tests needs

    deviation = allantools.oadev(values, rate=rate_hz, data_type="freq", taus=[tau_s])[1]
    return float(deviation[0])


def markov_allan(sd: float, correlation_s: float, tau_s: float) -> float:
    """Allan deviation of a Gauss-Markov process (IEEE Std 952-1997, annex C)."""
    ratio = correlation_s / tau_s
    bracket = 1 - ratio / 2 * (3 - 4 * np.exp(-1 / ratio) + np.exp(-2 / ratio))
    return float(sd * np.sqrt(2 * ratio * bracket))


@pytest.mark.parametrize("tau_s", [5.0, 20.0, 100.0])
def test_a_gauss_markov_process_has_its_allan_deviation(tau_s: float) -> None:
    values = GaussMarkov([2.0, 2.0, 5.0], 10.0, 0.5, generator(1, "a")).take(200_000)
    for axis, sd in enumerate((2.0, 2.0, 5.0)):
        assert allan(values[:, axis], 2.0, tau_s) == pytest.approx(markov_allan(sd, 10.0, tau_s), rel=0.06)


def test_a_gauss_markov_process_is_in_equilibrium_from_the_start_on() -> None:
    firsts = np.array(
        [GaussMarkov([2.0], 1000.0, 0.01, generator(seed, "b")).take(1)[0, 0] for seed in range(2000)]
    )
    assert firsts.std() == pytest.approx(2.0, rel=0.07)
    long = GaussMarkov([2.0], 10.0, 1.0, generator(3, "c")).take(200_000)[:, 0]
    assert long.std() == pytest.approx(2.0, rel=0.03)
    assert np.corrcoef(long[:-10], long[10:])[0, 1] == pytest.approx(np.exp(-1), abs=0.03)


def test_a_random_walk_grows_with_the_root_of_time() -> None:
    ends = np.array([RandomWalk([0.5], 0.1, generator(seed, "d")).take(400)[-1, 0] for seed in range(1500)])
    assert ends.std() == pytest.approx(0.5 * np.sqrt(40.0), rel=0.08)


def test_blocks_continue_each_other() -> None:
    for make in (
        lambda: White([1.0, 2.0], generator(1, "e")),
        lambda: GaussMarkov([1.0, 2.0], 3.0, 0.1, generator(1, "e")),
        lambda: RandomWalk([1.0, 2.0], 0.1, generator(1, "e")),
    ):
        whole, parts = make(), make()
        pieces = np.concatenate([parts.take(n) for n in (1, 99, 400)])
        np.testing.assert_allclose(pieces, whole.take(500), rtol=1e-12, atol=1e-12)


def test_generators_differ_by_seed_and_by_name() -> None:
    draws = {
        (seed, name): generator(seed, name).standard_normal() for seed in (0, 1, 2**40) for name in ("a", "b")
    }
    assert len(set(draws.values())) == len(draws)
    assert generator(0, "a").standard_normal() == draws[0, "a"]
