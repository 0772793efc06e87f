"""Deviations against a published set, another implementation, and closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.allan.analysis import analyse, variances
from imumon.allan.covariance import Kind
from imumon.allan.series import EvenSeries, even_channels, octaves
from imumon.blocks import FloatArray
from tests.allan.simulated import nist_1000, noise


def even(values: FloatArray, interval_ns: int = 1_000_000_000) -> EvenSeries:
    n = len(values)
    return even_channels(np.arange(n) * interval_ns, np.zeros(n, np.int64), {"x": values})["x"]


# NIST SP 1065 (2008), table 31.
PUBLISHED: dict[Kind, list[float]] = {
    "allan": [2.922319e-01, 9.159953e-02, 3.241343e-02],
    "modified": [2.922319e-01, 6.172376e-02, 2.170921e-02],
    "hadamard": [2.943883e-01, 9.581083e-02, 3.237638e-02],
}


@pytest.mark.parametrize("kind", PUBLISHED)
def test_the_nist_set_gives_the_published_deviations(kind: Kind) -> None:
    values = nist_1000()
    np.testing.assert_array_equal((values[1:4] * 2147483647).round(), [395529916, 1209410747, 633705974])
    found = np.sqrt(variances(even(values), np.array([1, 10, 100]))[kind])
    np.testing.assert_allclose(found, PUBLISHED[kind], atol=5.1e-8)


@pytest.mark.parametrize(
    ("kind", "theirs"),
    [("allan", "oadev"), ("modified", "mdev"), ("hadamard", "ohdev")],
)
def test_deviations_are_those_of_allantools(kind: Kind, theirs: str) -> None:
    import allantools  # takes a second, which not every process of the tests needs

    interval_s = 0.0025
    values = 0.3 + noise(1, 50_000, interval_s, white=1e-3, walk=1e-4, quantization=1e-6)
    series = even(values, 2_500_000)
    factors = octaves(series)[:-2]
    tau, deviations, _, _ = getattr(allantools, theirs)(values, 1 / interval_s, "freq", factors * interval_s)
    np.testing.assert_allclose(tau, factors * interval_s)
    np.testing.assert_allclose(np.sqrt(variances(series, factors)[kind]), deviations, rtol=1e-9)


def twin(kind: Kind, values: FloatArray, m: int) -> float:
    """Return the variance by the definition, with means of m samples."""
    means = np.convolve(values, np.ones(m) / m, "valid")
    if kind == "hadamard":
        return float(np.mean((means[2 * m :] - 2 * means[m:-m] + means[: -2 * m]) ** 2) / 6)
    steps = means[m:] - means[:-m]
    if kind == "modified":
        steps = np.convolve(steps, np.ones(m) / m, "valid")
    return float(np.mean(steps**2) / 2)


@pytest.mark.parametrize("kind", PUBLISHED)
@pytest.mark.parametrize("m", [1, 2, 7, 33])
def test_kernels_follow_the_definition_by_means(kind: Kind, m: int) -> None:
    values = noise(2, 500, 1.0, white=1.0, walk=0.3)
    found = variances(even(values), np.array([m]))[kind][0]
    assert found == pytest.approx(twin(kind, values, m), rel=1e-10)


def test_a_constant_bias_does_not_matter_and_a_ramp_gives_its_line() -> None:
    values = noise(3, 4000, 0.01, white=1.0)
    factors = np.array([1, 8, 64, 512])
    plain = variances(even(values, 10_000_000), factors)["allan"]
    np.testing.assert_allclose(variances(even(values + 5, 10_000_000), factors)["allan"], plain, rtol=1e-9)
    ramp = even(np.asarray(2.0 * 0.01 * np.arange(4000)), 10_000_000)
    np.testing.assert_allclose(np.sqrt(variances(ramp, factors)["allan"]), 2.0 * 0.01 * factors / np.sqrt(2))
    np.testing.assert_allclose(variances(ramp, factors)["hadamard"], 0.0, atol=1e-20)


def test_channels_of_one_record_are_analysed_alike_and_alone() -> None:
    channels = {name: even(noise(seed, 5000, 0.01, white=1.0)) for seed, name in enumerate("ab")}
    together = analyse(channels)
    alone = analyse({"b": channels["b"]})["b"]
    np.testing.assert_array_equal(together["b"].allan.values, alone.allan.values)
    assert together["b"].fit is not None
    assert alone.fit is not None
    assert together["b"].fit.terms == alone.fit.terms


def test_intervals_hold_the_true_deviation_as_often_as_they_say() -> None:
    hits, n = [], 2048
    records = {str(seed): noise(100 + seed, n, 1.0, white=1.0) for seed in range(40)}
    series = even_channels(np.arange(n) * 1_000_000_000, np.zeros(n, np.int64), records)
    for result in analyse(series).values():
        for deviations, truth in (
            (result.allan, result.tau_s**-0.5),
            (result.hadamard, result.tau_s**-0.5),
            (result.modified, np.sqrt((1 + 1 / (result.tau_s) ** 2) / (2 * result.tau_s))),
        ):
            hits.append((deviations.low < truth) & (truth < deviations.high))
    share = np.mean([row[: result.trusted] for row in hits])
    assert 0.64 < share < 0.73  # 0.683 is stated
