"""Effects: one object to simulate, to regress and to carry along live, and the same numbers in each."""

from __future__ import annotations

import re
from dataclasses import replace
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from pydantic import ValidationError

from imumon.blocks import FloatArray, IntArray
from imumon.effects import library
from imumon.effects.base import Drive, Effect, Scale, Survey
from imumon.effects.kinds import SEPARATED_BY
from imumon.effects.library import EFFECTS
from imumon.effects.product import GSensitivity
from imumon.effects.since_power_on import Step, StressRelaxation, WarmUp
from imumon.effects.thermal_lag import DeadTime, Hysteresis, TemperatureRate, ThermalLag
from imumon.effects.vibration import Vibration
from imumon.lab.diagnosis.search import REFINEMENTS
from imumon.models.predictor import Carrier

SURVEY = Survey((7200.0, 7200.0), 30.0, 4, 19.6, 30.0, 3, Scale(25.0, 15.0))


def run(n: int = 4000, seed: int = 0) -> Drive:
    """Return a ramp up, a soak and a ramp down, at odd times, with a unit that is turned over."""
    random = np.random.default_rng(seed)
    time = np.sort(random.uniform(0.0, 4000.0, n))
    temperature = np.interp(time, [0, 1500, 2200, 4000], [20.0, 38.0, 38.0, 15.0])
    accel = np.where((time < 2000)[:, np.newaxis], [0.0, 0.0, 9.8], [9.8, 0.0, 0.0])
    supply = 5.0 + 0.1 * np.sin(time / 300.0)
    return Drive(time, temperature + random.normal(0, 0.02, n), accel, {"supply_voltage": supply})


def one_of_each() -> list[Effect]:
    """Return one effect of each family, with coefficients, and one of another driver where there can be."""
    driven = SURVEY._replace(others={"supply_voltage": Scale(5.0, 0.1)})
    found = []
    for family in EFFECTS.values():
        for effect in (*family.grid(SURVEY)[:1], *family.driven(driven, "supply_voltage")[:1]):
            found.append(effect.with_coefficients(np.arange(1.0, effect.width + 1)))
    return found


def live(effect: Effect, drive: Drive, size: int, segment: IntArray | None = None) -> tuple[FloatArray, ...]:
    """Return bias and start_sd, carried along in blocks of a size."""
    carrier = Carrier(effect)
    time_ns = np.round(drive.time_s * 1e9).astype(np.int64)
    label = np.zeros(len(drive), np.int64) if segment is None else segment
    force = drive.accel
    assert force is not None
    drivers = {"temperature": drive.temperature_degc, "accel": force, **drive.others}
    parts = [
        carrier.process(
            time_ns[i : i + size],
            label[i : i + size],
            {name: values[i : i + size] for name, values in drivers.items()},
        )
        for i in range(0, len(drive), size)
    ]
    return tuple(np.concatenate(part) for part in zip(*parts, strict=True))


@pytest.mark.parametrize("effect", one_of_each(), ids=lambda effect: effect.label)
def test_the_width_is_the_number_of_columns(effect: Effect) -> None:
    assert effect.columns(run(50)).shape == (50, effect.width)


@pytest.mark.parametrize("effect", one_of_each(), ids=lambda effect: effect.label)
@pytest.mark.parametrize("size", [1, 7, 333])
def test_the_division_into_blocks_does_not_matter(effect: Effect, size: int) -> None:
    drive = run(1000)
    segment = np.repeat([3, 4], [420, 580])
    for whole, parts in zip(
        live(effect, drive, 1000, segment), live(effect, drive, size, segment), strict=True
    ):
        np.testing.assert_array_equal(whole, parts)


@pytest.mark.parametrize("effect", one_of_each(), ids=lambda effect: effect.label)
def test_live_it_is_what_is_simulated(effect: Effect) -> None:
    drive = run()
    since = replace(drive, time_s=drive.time_s - drive.time_s[0])
    bias, _ = live(effect, drive, 100)
    expected = effect.simulate(since)
    assert np.median(np.abs(bias - expected)) <= 1e-6 * np.ptp(expected) + 1e-9
    assert np.abs(bias).max() > 1e-4


def plain_lag(drive: Drive, tau: float) -> FloatArray:
    """Twin: the integral of (T - L)/tau in a thousand small steps between samples."""
    lagged = [float(drive.temperature_degc[0])]
    for i in range(1, len(drive)):
        steps = 400
        at = lagged[-1]
        dt = (drive.time_s[i] - drive.time_s[i - 1]) / steps
        for k in range(steps):
            share = (k + 0.5) / steps
            value = (1 - share) * drive.temperature_degc[i - 1] + share * drive.temperature_degc[i]
            at += dt * (value - at) / tau
        lagged.append(at)
    return np.array(lagged)


def test_a_lag_is_the_solution_of_its_equation() -> None:
    drive = run(150)
    effect = ThermalLag(time_constant_s=200.0, middle=0.0, half_span=1.0)
    lag = drive.temperature_degc - effect.columns(drive)[:, 0]
    np.testing.assert_allclose(lag, plain_lag(drive, 200.0), atol=2e-3)


def test_a_loop_stays_in_a_soak_and_a_lag_does_not() -> None:
    drive = run()
    soak = (drive.time_s > 2100) & (drive.time_s < 2200)
    lag = ThermalLag(time_constant_s=60.0, middle=0.0, half_span=1.0, coefficients=[1.0])
    loop = Hysteresis(half_width=2.0, middle=0.0, half_span=1.0, coefficients=[1.0])
    assert np.abs(lag.simulate(drive)[soak]).max() < 0.1
    assert np.abs(loop.simulate(drive)[soak]).min() > 1.8


@pytest.mark.parametrize("shape", ["play", "smooth"])
def test_the_unknown_start_of_a_loop_ends_when_it_saturates(shape: str) -> None:
    effect = Hysteresis.model_validate(
        {
            "half_width": 2.0,
            "shape": shape,
            "middle": 0.0,
            "half_span": 1.0,
            "coefficients": [3.0],
        }
    )
    _, start_sd = live(effect, run(), 1000)
    assert start_sd[0] == pytest.approx(3.0 * 2.0 / np.sqrt(3.0), rel=0.03)
    assert start_sd[-1] < 0.01


def test_the_unknown_start_of_a_lag_decays_with_its_time_constant() -> None:
    effect = ThermalLag(time_constant_s=300.0, middle=0, half_span=10, start_sd=2.0, coefficients=[5.0])
    drive = run()
    _, start_sd = live(effect, drive, 1000)
    expected = 5.0 * 2.0 / 10 * np.exp(-(drive.time_s - drive.time_s[0]) / 300.0)
    np.testing.assert_allclose(start_sd, expected, atol=1e-9)


def test_without_its_driver_the_bias_is_not_known() -> None:
    effect = ThermalLag(
        driver="supply_voltage", time_constant_s=60.0, middle=5.0, half_span=0.1, coefficients=[1.0, 0.0]
    )
    bias, _ = Carrier(effect).process(np.arange(3), np.zeros(3, np.int64), {"temperature": np.full(3, 20.0)})
    assert np.isnan(bias).all()


def test_keys_of_the_first_format_are_read_and_the_driver_is_then_the_temperature() -> None:
    old = {"time_constant_s": 60.0, "middle_degc": 25.0, "half_span_degc": 10.0, "start_sd_degc": 2.0}
    effect = ThermalLag.model_validate(old)
    assert (effect.driver, effect.middle, effect.start_sd) == ("temperature", 25.0, 2.0)


def test_the_vibration_of_a_second_is_the_variance_of_its_samples() -> None:
    random = np.random.default_rng(1)
    accel = random.normal(0, 0.3, (1000, 3))
    time_ns = np.arange(1000) * 10_000_000
    whole = Vibration().process(time_ns, np.zeros(1000, np.int64), accel)
    carried = Vibration()
    parts = [
        carried.process(time_ns[i : i + 7], np.zeros(len(time_ns[i : i + 7]), np.int64), accel[i : i + 7])
        for i in range(0, 1000, 7)
    ]
    np.testing.assert_array_equal(whole, np.concatenate(parts))
    assert np.isnan(whole[:100]).all()
    assert whole[100] == pytest.approx(accel[:100].var(axis=0, ddof=1).sum())


def test_a_restart_of_the_device_forgets_the_state() -> None:
    effect = ThermalLag(time_constant_s=300.0, middle=0.0, half_span=1.0, coefficients=[1.0])
    drive = run(1000)
    bias, start_sd = live(effect, drive, 1000, np.repeat([0, 1], [400, 600]))
    assert abs(bias[399]) > 1.0
    assert bias[400] == 0.0
    assert start_sd[400] == start_sd[0]


def test_an_effect_of_the_specific_force_adds_nothing_without_it() -> None:
    effect = GSensitivity(coefficients=[1.0, 2.0, 3.0])
    drivers = {"temperature": np.full(3, 20.0)}
    bias, start_sd = Carrier(effect).process(np.arange(3), np.zeros(3, np.int64), drivers)
    assert not bias.any()
    assert not start_sd.any()


@pytest.mark.parametrize("value", [0.0, -1.0, float("nan"), float("inf")])
def test_an_impossible_time_constant_is_refused(value: float) -> None:
    with pytest.raises(ValidationError):
        ThermalLag(time_constant_s=value, middle=0.0, half_span=1.0)


def test_the_library_has_every_effect_of_the_folder() -> None:
    text = "".join(path.read_text() for path in Path(library.__file__).parent.glob("*.py"))
    assert {*re.findall(r"    kind: Literal\[\"(\w+)\"\]", text)} == set(EFFECTS)


def test_what_tells_effects_apart_is_of_the_library() -> None:
    assert {name for pair in SEPARATED_BY for name in pair} <= set(EFFECTS)
    assert all(first < second for first, second in SEPARATED_BY)


@pytest.mark.parametrize(
    ("one", "other", "what"),
    [
        ("thermal_lag", "dead_time", "a fast ramp into a soak"),
        ("hysteresis", "temperature_curve", "a turn of the temperature inside the range"),
        ("warm_up", "thermal_lag", "power-on in equilibrium with the ambient held"),
        ("temperature_curve", "temperature_rate", "ramps at another rate"),
        ("drift", "temperature_curve", "downwards"),
        ("curve(supply)", "drift", "what curve(supply) depends on goes another way than the rest"),
        ("curve(supply)", "lag(supply)", "depends on goes up and down at two rates, and is held"),
    ],
)
def test_what_is_to_be_recorded_does_not_depend_on_which_effect_is_first(
    one: str, other: str, what: str
) -> None:
    assert what in library.separated_by(one, other)
    if "(" not in one:
        assert library.separated_by(one, other) == library.separated_by(other, one)


def test_a_delay_gives_the_temperature_that_was() -> None:
    effect = DeadTime(delay_s=200.0, middle=0.0, half_span=1.0)
    time: FloatArray = np.linspace(0.0, 4000.0, 8001)
    temperature = np.interp(time, [0, 1500, 2200, 4000], [20.0, 38.0, 38.0, 15.0])
    was = temperature - effect.columns(Drive(time, temperature))[:, 0]
    np.testing.assert_allclose(was[400:], temperature[:-400], atol=1e-9)
    assert np.all(was[:400] == 20.0)


@pytest.mark.parametrize("exponent", [0.3, 0.5, 0.7])
def test_a_spectrum_of_one_sign_has_the_shape_of_a_stretched_exponential(exponent: float) -> None:
    drive = Drive(np.arange(15.0, 7200.0, 30.0), np.full(240, 20.0))
    true = np.exp(-((drive.time_s / 200.0) ** exponent))

    def left(effect: StressRelaxation) -> float:
        design = np.column_stack([np.ones(len(drive)), effect.columns(drive)])
        found = np.linalg.lstsq(design, true, rcond=None)[0]
        return float(np.std(true - design @ found) / np.std(true)) if found[1:].min() > 0 else 1.0

    tried = StressRelaxation.grid(SURVEY)
    assert min(map(left, tried)) < 0.015
    assert min(left(effect) for effect in tried if effect.steps == 1) > 0.025


def test_a_narrow_step_of_barriers_is_an_exponential_and_one_at_power_on_is_its_width() -> None:
    narrow = StressRelaxation(time_constant_s=100.0, ratio=1.01)
    time = np.array([0.0, 50.0, 400.0])
    columns = narrow.columns(Drive(time, np.full(3, 20.0)))[:, 0] / np.log(1.01)
    np.testing.assert_allclose(columns, np.exp(-time / 100.5), rtol=1e-3)


def test_a_spectrum_has_the_same_share_of_each_decade_however_wide_it_is() -> None:
    """Of slow barriers nothing has relaxed after a second: 0.51 was left of the last step."""
    wide = StressRelaxation(time_constant_s=60.0, ratio=1e4, steps=5)
    columns = wide.columns(Drive(np.ones(1), np.full(1, 20.0)))[0]
    np.testing.assert_allclose(columns[1:], np.log(1e4), rtol=1e-5)


TEN_HOURS = SURVEY._replace(durations_s=(36_000.0, 7200.0), others={"supply_voltage": Scale(5.0, 0.1)})


@pytest.mark.parametrize(
    "grid",
    [
        ThermalLag.driven(TEN_HOURS, "supply_voltage"),
        Hysteresis.driven(TEN_HOURS, "supply_voltage"),
        TemperatureRate.driven(TEN_HOURS, "supply_voltage"),
        [one for one in ThermalLag.grid(TEN_HOURS) if one.order == 1],
        WarmUp.grid(TEN_HOURS),
        Step.grid(TEN_HOURS)[:50],
    ],
    ids=lambda grid: grid[0].label,
)
def test_refining_reaches_whatever_lies_between_two_of_a_grid(grid: list[Effect]) -> None:
    """Of another driver, and of jumps in a long run, it ended before the middle."""
    name = grid[0].nonlinear[0]
    for found, following in pairwise(grid):
        low, high = getattr(found, name), getattr(following, name)
        target = 0.5 * (low + high) if name == "time_s" else float(np.sqrt(low * high))
        best = found
        for level in range(REFINEMENTS):
            neighbours = [best, *best.refined(TEN_HOURS, level)]
            best = min(neighbours, key=lambda one: abs(getattr(one, name) - target))
        assert getattr(best, name) == pytest.approx(target, rel=0.01)


def test_the_start_of_a_lag_of_another_driver_stays_as_sure_as_it_was_declared() -> None:
    """It was at least 1, of whatever unit."""
    lag = ThermalLag(driver="supply_voltage", time_constant_s=60.0, start_sd=0.01, middle=5.0, half_span=0.1)
    lag = lag.with_coefficients([1e-4, 0.0])
    assert lag.with_start(np.array([0.5e-4])).start_sd == 0.01
    assert lag.with_start(np.array([3e-4])).start_sd == pytest.approx(0.03)


def test_what_the_runs_cannot_show_is_not_tried() -> None:
    still = Survey((7200.0,), 0.5, 0, 0.0, 30.0, 3, Scale(25.0, 0.25))
    tried = {name for name, family in EFFECTS.items() if family.grid(still)}
    assert tried == {"warm_up", "stress_relaxation", "drift", "step", "periodic"}
