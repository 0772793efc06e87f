"""The direction that each hypothesis makes likeliest."""

from __future__ import annotations

import numpy as np
import pytest

from imumon.estimation.alignment.posterior import _closest

DIRECTIONS = np.linspace(0.0, 2.0 * np.pi, 721)
AROUND = np.stack([np.ones_like(DIRECTIONS), np.cos(DIRECTIONS), np.sin(DIRECTIONS)])


@pytest.mark.parametrize("scale", [1e-2, 1.0, 1e2, 1e4])
@pytest.mark.parametrize("of_sine", [1.0, 1e-4])
def test_no_direction_is_likelier_than_the_one_that_is_found(scale: float, of_sine: float) -> None:
    rng = np.random.default_rng(1)
    rows = scale * rng.normal(size=(2000, 6, 3)) * np.exp(2.0 * rng.normal(size=(2000, 6, 1)))
    rows[..., 2] *= of_sine
    rows[:1000, :, 0] = rng.normal(size=(1000, 6)) - rows[:1000, :, 1:] @ [np.cos(1.0), np.sin(1.0)]
    forms = rows.swapaxes(1, 2) @ rows
    angle, misfit, _ = _closest(forms)
    x = np.stack([np.ones_like(angle), np.cos(angle), np.sin(angle)], 1)
    everywhere = np.sum(AROUND * (forms @ AROUND), axis=1)
    rounding = 1e-12 * np.abs(forms).sum((1, 2))
    np.testing.assert_allclose(misfit, np.einsum("ni,nij,nj->n", x, forms, x), atol=rounding.max())
    assert np.all(misfit < everywhere.min(1) + 0.01 + rounding)
