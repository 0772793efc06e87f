"""The prediction sample by sample: the curve, in any division, with what is missing held."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt
import pytest

from imumon.blocks import FloatArray, IntArray
from imumon.effects.thermal_lag import ThermalLag
from imumon.errors import ImumonError
from imumon.models.model import BiasModel
from imumon.models.predictor import BiasPredictor
from tests.models.models import three_curves

CHANNELS = ["gyro_z", "gyro_x", "gyro_y"]


def plain(
    model: BiasModel, segment: IntArray, temperature: FloatArray
) -> tuple[FloatArray, FloatArray, npt.NDArray[np.bool_]]:
    """Return what the curves themselves give, the temperature held row by row."""
    held = temperature.copy()
    for i in range(1, len(held)):
        missing = np.isnan(held[i]) & (segment[i] == segment[i - 1])
        held[i, missing] = held[i - 1, missing]
    models = [model.channels[name] for name in CHANNELS]
    columns = [(m.value(t), m.slope(t), m.inside(t)) for m, t in zip(models, held.T, strict=True)]
    bias, slope, inside = (np.column_stack(parts) for parts in zip(*columns, strict=True))
    slope[np.isnan(held)] = np.nan
    return bias, slope, inside


def record(n: int = 3000, seed: int = 0) -> tuple[IntArray, IntArray, FloatArray]:
    """Return times, segments and temperatures from far below to far above the range, with gaps."""
    random = np.random.default_rng(seed)
    segment = np.sort(random.integers(0, 4, n))
    temperature = np.linspace(-45.0, 75.0, n)[:, np.newaxis] + random.normal(0.0, 3.0, (n, 3))
    temperature[random.random((n, 3)) < 0.3] = np.nan
    temperature[:20] = np.nan
    return np.arange(n) * 10_000_000, segment, temperature


def test_the_prediction_is_what_the_curves_give() -> None:
    time_ns, segment, temperature = record()
    result = BiasPredictor(three_curves(), CHANNELS).process(time_ns, segment, temperature)
    bias, slope, inside = plain(three_curves(), segment, temperature)
    assert np.isnan(result.bias[:20]).all()
    np.testing.assert_allclose(result.bias, bias, rtol=0, atol=1e-12)
    np.testing.assert_allclose(result.slope, slope, rtol=0, atol=1e-10)
    np.testing.assert_array_equal(result.inside, inside)
    assert 0.2 < inside.mean() < 0.8


@pytest.mark.parametrize("size", [1, 7, 1000])
def test_the_division_into_blocks_does_not_matter(size: int) -> None:
    time_ns, segment, temperature = record(1500)
    whole = BiasPredictor(three_curves(), CHANNELS).process(time_ns, segment, temperature)
    predictor = BiasPredictor(three_curves(), CHANNELS)
    parts = [
        predictor.process(time_ns[i : i + size], segment[i : i + size], temperature[i : i + size])
        for i in range(0, 1500, size)
    ]
    for name in ("bias", "slope", "inside"):
        joined = np.concatenate([getattr(part, name) for part in parts])
        np.testing.assert_array_equal(joined, getattr(whole, name))


def test_a_missing_temperature_is_held_until_the_device_restarts() -> None:
    temperature = np.array([[20.0], [np.nan], [np.nan], [25.0]])
    predictor = BiasPredictor(three_curves(), ["gyro_x"])
    result = predictor.process(np.arange(4), np.array([0, 0, 1, 1]), temperature)
    expected = three_curves().channels["gyro_x"].value([20.0, 20.0, np.nan, 25.0])
    np.testing.assert_allclose(result.bias[:, 0], expected, rtol=1e-12)
    assert result.inside[:, 0].tolist() == [True, True, False, True]


def test_an_effect_has_the_temperature_that_is_held_and_before_the_first_there_is_no_bias() -> None:
    lag = ThermalLag(time_constant_s=100.0, middle=0.0, half_span=1.0, coefficients=[1.0])
    model = three_curves()
    lagging = model.channels["gyro_x"].model_copy(update={"effects": [lag]})
    model = model.model_copy(update={"channels": {"gyro_x": lagging}})
    temperature = np.array([[np.nan], [np.nan], [20.0], [25.0], [np.nan], [np.nan]])
    result = BiasPredictor(model, ["gyro_x"]).process(
        np.arange(6) * 10_000_000_000, np.zeros(6, np.int64), temperature
    )
    added = result.bias[:, 0] - three_curves().channels["gyro_x"].value([np.nan, np.nan, 20.0, *[25.0] * 3])
    assert np.isnan(added[:2]).all()
    assert abs(added[2]) < 1e-9
    assert added[3] > added[4] > added[5] > 0.0


def test_a_channel_that_the_model_lacks_is_refused() -> None:
    with pytest.raises(ImumonError, match="has no accel_x; it has gyro_x, gyro_y, gyro_z"):
        BiasPredictor(three_curves(), ["gyro_x", "accel_x"])
