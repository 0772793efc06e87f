from __future__ import annotations

import math

import numpy as np
import pytest

from imumon.blocks import FloatArray
from imumon.estimation.alignment.fit import PoseRecord, fit_pose
from imumon.estimation.alignment.lines import without_lines
from imumon.estimation.alignment.windows import CELLS, bank, in_cells, layout, trend, weighted_bank
from tests.estimation.alignment.units import ANY_REST

SLOT_S = 0.25


@pytest.mark.parametrize(("cells", "hop"), [(40, 1), (160, 1), (156, 5)])
def test_the_scatter_tells_the_noise_of_white_rows(cells: int, hop: int) -> None:
    rng = np.random.default_rng(cells + hop)
    rows, weights = (cells + 1) * hop if hop > 1 else cells, layout(hop * CELLS)[1]
    expected = float(weights @ weights)
    found = []
    for _ in range(40):
        data = in_cells(rng.normal(size=(rows, 2)), cells, weights)
        found.append([windows.scatter(data)[0] for windows in bank(cells, hop)])
    # Few degrees of freedom make it larger on purpose; the widest has at least six.
    mean = np.mean(found, axis=0) / expected
    assert mean[0] == pytest.approx(1.0, abs=0.15)
    assert (mean > 0.85).all()
    assert (mean < 1.9).all()


def test_what_has_a_period_in_a_hop_does_not_turn_up_as_slow() -> None:
    rows = 2400
    cells, weights = layout(rows)
    hop = len(weights) // 2
    fast = np.sin(2.0 * math.pi * 1.02 / hop * np.arange(rows))
    assert np.abs(in_cells(fast[:, None], cells, weights)).max() < 1e-3
    assert in_cells(np.ones((rows, 1)), cells, weights) == pytest.approx(1.0)


def test_lines_are_taken_off_and_a_resonance_is_not() -> None:
    rng, n = np.random.default_rng(0), 800
    t = np.arange(n)
    noise = rng.normal(size=n) + 1j * rng.normal(size=n)
    sway = 200.0 * np.sin(0.0713 * t) * (0.6 + 0.8j) + 30.0 * np.cos(1.91 * t + 1.0)
    left = without_lines(noise + sway, trend(n), np.ones(n))
    assert np.abs(left).std() < 1.1 * np.abs(noise).std()
    assert abs((left - noise).mean()) < 0.05
    shaken = noise.copy()
    for k in range(2, n):
        shaken[k] += 1.9 * shaken[k - 1] - 0.97 * shaken[k - 2]
    assert without_lines(shaken, trend(n), np.ones(n)) is shaken


def _pose(seconds: float, angle: FloatArray, seed: int = 0) -> PoseRecord:
    """Return a record of white fibre-optic gyros on a unit that tilts by an angle about forward."""
    rng, n = np.random.default_rng(seed), round(seconds / SLOT_S)
    rate = 5.8e-7 * rng.normal(size=(n, 3)) + [5e-5, 2e-5, 4e-5]
    rate[:, 0] += np.diff(angle) / SLOT_S
    level = angle[1:] + 1e-5 * (rng.normal(size=n) + 1j * rng.normal(size=n))
    return PoseRecord(SLOT_S * np.arange(0.5, n), np.full(n, 25.0), rate, level)


@pytest.mark.parametrize(("hertz", "amplitude"), [(0.2, 2e-5), (0.31, 2e-4), (1.3, 5e-6)])
def test_a_sway_stays_out_of_the_mean(hertz: float, amplitude: float) -> None:
    edges = SLOT_S * np.arange(481)
    errors = []
    for seed in range(6):
        found = fit_pose(
            _pose(120.0, amplitude * np.sin(2.0 * math.pi * hertz * edges + seed), seed), ANY_REST
        )
        assert found is not None
        errors.append(found.mean[0] - (5e-5 + 2e-5j))
        assert found.variance[0] < (2.0 * 2.9e-7) ** 2 / 120.0
    assert float(np.sqrt(np.mean(np.abs(errors) ** 2) / 2.0)) < 1.7 * 2.9e-7 / math.sqrt(120.0)


@pytest.mark.parametrize("tau_s", [13.0, 70.0])
def test_a_tripod_of_any_time_constant_is_followed(tau_s: float) -> None:
    edges = SLOT_S * np.arange(1201)
    found = fit_pose(_pose(300.0, -5e-4 * np.expm1(-edges / tau_s)), ANY_REST)
    assert found is not None
    best = int(np.argmax(found.log_weight))
    assert best > 0
    assert abs(found.mean[best] - (5e-5 + 2e-5j)) < 4.0 * math.sqrt(found.variance[best])
    assert math.sqrt(found.variance[best]) < 2e-7


def test_windows_that_see_the_same_few_cells_are_no_set() -> None:
    # What two lorries left of a record: between cells that do not count lie single ones, which several see.
    quiet = np.full(77, 2.079496e-6)
    quiet[[3, 8, 11, 12, 22, 23, 26, 27, 29, 30, 35, 42, 43, 45, 46, 51, 52, 72, 73, 74]] = 0.0
    for windows in weighted_bank(quiet, 3):
        values = np.linalg.eigvalsh(windows.covariance)
        assert values[0] > 1e-10 * values[-1]
