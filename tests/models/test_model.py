"""The model file: exact, strict, and clear about what is wrong with it."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np
import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from imumon.columns import BodyAxes
from imumon.config import parse_yaml
from imumon.errors import ImumonError, Reason
from imumon.models.curves.network import NetworkCurve
from imumon.models.curves.polynomial import PolynomialCurve
from imumon.models.curves.spline import SplineCurve
from imumon.models.model import REACH, BiasModel, Curve, load_model
from tests.models.models import NETWORK, POLYNOMIAL, SPLINE, channel, three_curves

LARGEST = 2.0**62
finite = st.floats(-LARGEST, LARGEST)
positive = st.floats(1e-300, LARGEST)


def lists(n: int) -> st.SearchStrategy[list[float]]:
    return st.lists(finite, min_size=n, max_size=n)


@st.composite
def splines(draw: st.DrawFn) -> SplineCurve:
    knots = sorted(draw(st.lists(finite, min_size=2, max_size=9, unique=True)))
    n = len(knots)
    return SplineCurve(knots_degc=knots, values=draw(lists(n)), slopes=draw(lists(n)))


@st.composite
def networks(draw: st.DrawFn) -> NetworkCurve:
    n = draw(st.integers(1, 4))
    return NetworkCurve(
        center_degc=draw(finite),
        half_width_degc=draw(positive),
        offset=draw(finite),
        scale=draw(positive),
        first_weights=draw(lists(n)),
        first_biases=draw(lists(n)),
        second_weights=draw(st.lists(lists(n), min_size=n, max_size=n)),
        second_biases=draw(lists(n)),
        output_weights=draw(lists(n)),
        output_bias=draw(finite),
    )


polynomials = st.builds(
    PolynomialCurve,
    center_degc=finite,
    half_width_degc=positive,
    coefficients=st.lists(finite, min_size=1, max_size=13),
)
curves: st.SearchStrategy[Curve] = st.one_of(polynomials, splines(), networks())


@settings(max_examples=60, deadline=None)
@given(curve=curves, serial=st.none() | st.text())
def test_what_is_read_equals_what_was_written_to_the_bit(curve: Curve, serial: str | None) -> None:
    model = three_curves().model_copy(update={"channels": {"gyro_x": channel(curve)}, "serial": serial})
    try:
        text = model.to_yaml()
    except UnicodeEncodeError:  # a lone surrogate is no text
        return
    assert parse_yaml(text, BiasModel, "model") == model


@settings(max_examples=80, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_file_is_refused_in_words_or_read(data: st.DataObject, tmp_path: Path) -> None:
    text = three_curves().to_yaml()
    start = data.draw(st.integers(0, len(text)))
    stop = data.draw(st.integers(start, min(len(text), start + 30)))
    inserted = data.draw(st.text(st.characters(codec="utf-8"), max_size=8))
    path = tmp_path / "model.yaml"
    path.write_bytes((text[:start] + inserted + text[stop:]).encode())
    refused = None
    try:
        load_model(path)
    except ImumonError as error:
        refused = error
    assert refused is None or (refused.reason is Reason.BAD_CONFIG and str(path) in refused.seen)


@pytest.mark.parametrize("serial", ["A\x85B", "A\u2028B", "1e5", "1e-6", "on", "0x1F", "12:30", "a\n b", ""])
def test_no_serial_number_is_read_as_something_else(serial: str) -> None:
    model = three_curves().model_copy(update={"serial": serial})
    assert parse_yaml(model.to_yaml(), BiasModel, "model") == model


def test_a_written_file_is_read_again(tmp_path: Path) -> None:
    model, path = three_curves(), tmp_path / "model.yaml"
    model.write(path)
    assert load_model(path) == model
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("line", "instead", "said"),
    [
        ("format: imumon-bias-model/2", "format: imumon-bias-model/9", ":1: format: "),
        ("    effects: []", "    effects: [{kind: drift}]", "drift needs 1 coefficients, there are 0"),
        (
            "    effects: []",
            "    effects: [{kind: stress_relaxation, time_constant_s: 60.0, exponent: 0.3}]",
            "exponent: unknown key",
        ),
        ("    unit: rad/s", "    unit: deg/s", "unit: "),
        ("    unit: rad/s", "    unit: m/s^2", "channel gyro_x is in rad/s, not m/s^2"),
        ("  gyro_x:", "  gyro_q:", "channel 'gyro_q' is not known"),
        ("    temperature_range_degc: [-20.0, 48.0]", "    temperature_range_degc: [48.0, 48.0]", "is empty"),
        ("    residual_sd: 1.0e-06", "    residual_sd: .nan", ".nan is not a reasonable number"),
        ("      kind: polynomial", "      kind: rational", "curve: "),
        ("      kind: polynomial", "      kind: polynomial\n      order: 3", "order: unknown key"),
        ("serial: null", "serial: null\nserial: 'A1'", "key 'serial' is there twice"),
    ],
)
def test_what_is_wrong_is_reported_with_file_and_line(
    line: str, instead: str, said: str, tmp_path: Path
) -> None:
    text = three_curves().to_yaml()
    assert line in text
    path = tmp_path / "model.yaml"
    path.write_text(text.replace(line, instead, 1), encoding="utf-8")
    with pytest.raises(ImumonError) as caught:
        load_model(path)
    assert caught.value.reason is Reason.BAD_CONFIG
    assert f"{path}:" in caught.value.seen
    assert said in caught.value.seen


@pytest.mark.parametrize(
    ("curve", "key", "value"),
    [
        (SPLINE, "values", [1.0]),
        (SPLINE, "knots_degc", [-20.0, -20.0, 48.0]),
        (NETWORK, "second_biases", [1.0]),
        (NETWORK, "second_weights", [[1.0, 2.0]]),
        (POLYNOMIAL, "coefficients", []),
        (POLYNOMIAL, "half_width_degc", 0.0),
    ],
)
def test_a_curve_that_does_not_fit_together_is_refused(curve: Curve, key: str, value: object) -> None:
    model = three_curves().model_dump()
    model["channels"]["gyro_x"]["curve"] = {**curve.model_dump(), key: value}
    with pytest.raises(ImumonError):
        parse_yaml(yaml.safe_dump(model), BiasModel, "model")


@pytest.mark.parametrize("curve", [POLYNOMIAL, SPLINE, NETWORK])
def test_the_slope_is_the_derivative_inside_and_outside(curve: Curve) -> None:
    model = channel(curve)
    edges = [-20.0, 48.0, -20.0 - REACH * 68.0, 48.0 + REACH * 68.0, *SPLINE.knots_degc]
    t = np.linspace(-40.0, 70.0, 4321)
    t = t[np.all(np.abs(t[:, np.newaxis] - edges) > 1e-3, axis=1)]
    h = 1e-4
    numeric = (model.value(t + h) - model.value(t - h)) / (2 * h)
    np.testing.assert_allclose(model.slope(t), numeric, rtol=1e-6, atol=1e-11)


def test_outside_the_range_the_tangent_is_followed_and_then_held() -> None:
    model = channel(POLYNOMIAL)
    reach = REACH * 68.0
    end, slope = float(model.value(48.0)), float(model.slope(48.0))
    assert math.isclose(float(model.value(48.0 + 0.5 * reach)), end + 0.5 * reach * slope)
    assert float(model.value(200.0)) == float(model.value(48.0 + reach))
    assert float(model.slope(200.0)) == 0.0
    assert model.inside([-20.1, -20.0, 48.0, 48.1]).tolist() == [False, True, True, False]


@pytest.mark.parametrize(
    ("serial", "axes", "reported"),
    [
        ("SN1", "FRD", ""),
        (None, None, ""),
        ("SN2", "FRD", "of unit SN1, this"),
        (None, "FLU", "axes FRD, this"),
    ],
)
def test_what_does_not_belong_to_a_model_is_reported(
    serial: str | None, axes: BodyAxes | None, reported: str
) -> None:
    model = three_curves().model_copy(update={"serial": "SN1", "axes": "FRD"})
    text = model.of_another(serial, axes)
    assert bool(text) is bool(reported)
    assert reported in text
