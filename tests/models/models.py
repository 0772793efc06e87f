"""Bias models for tests."""

from __future__ import annotations

from imumon.models.curves.network import NetworkCurve
from imumon.models.curves.polynomial import PolynomialCurve
from imumon.models.curves.spline import SplineCurve
from imumon.models.model import BiasModel, ChannelModel, Curve

POLYNOMIAL = PolynomialCurve(center_degc=14.0, half_width_degc=34.0, coefficients=[1e-4, 2e-3, -3e-4, 1e-4])
SPLINE = SplineCurve(
    knots_degc=[-20.0, 0.0, 48.0], values=[1e-3, -2e-3, 5e-4], slopes=[-1e-5, 2e-5, 1.0 / 3.0 * 1e-4]
)
NETWORK = NetworkCurve(
    center_degc=14.0,
    half_width_degc=34.0,
    offset=1e-3,
    scale=2e-3,
    first_weights=[1.5, -0.7],
    first_biases=[0.1, 0.4],
    second_weights=[[0.8, -1.1], [0.3, 0.9]],
    second_biases=[0.0, -0.2],
    output_weights=[1.2, -0.6],
    output_bias=0.05,
)


def channel(curve: Curve, unit: str = "rad/s", column: str = "temperature") -> ChannelModel:
    return ChannelModel.model_validate(
        {
            "unit": unit,
            "temperature_column": column,
            "temperature_range_degc": [-20.0, 48.0],
            "residual_sd": 1e-6,
            "curve": curve,
        }
    )


def three_curves() -> BiasModel:
    """Return a model with a curve of each kind."""
    curves: dict[str, Curve] = {"gyro_x": POLYNOMIAL, "gyro_y": SPLINE, "gyro_z": NETWORK}
    return BiasModel(
        made_by="imumon 0",
        created="2026-01-01T00:00:00Z",
        channels={name: channel(curve) for name, curve in curves.items()},
    )
