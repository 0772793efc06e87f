from __future__ import annotations

from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from imumon.errors import ImumonError, Reason
from imumon.files import bundled
from imumon.protocols.device import load_device
from imumon.simulation.unit import SimulatedUnit, load_scenario, load_unit
from imumon.simulation.unit.biases import axis_values
from imumon.simulation.unit.parameters import UnitParameters
from imumon.simulation.unit.scenario import Scenario

GOOD = """\
format: imumon-scenario/1
unit: crs05
rate_hz: 100
duration_s: 60
latitude_deg: 45
chamber: {start_degc: 20}
motion:
  - {kind: turn, at_s: 1, duration_s: 2}
"""


def refusal(path: Path, text: str) -> str:
    path.write_text(text)
    with pytest.raises(ImumonError) as caught:
        load_scenario(path)
    assert caught.value.reason is Reason.BAD_CONFIG
    return caught.value.seen


@pytest.mark.parametrize("name", sorted(bundled("scenarios")))
def test_every_scenario_that_comes_along_runs_and_fits_into_packets(name: str) -> None:
    plan = load_scenario(name)
    assert plan.title
    unit = SimulatedUnit(plan.played(plan.rate_hz, "FRD"))
    assert len(load_device("ax1").encoder().encode(unit.samples(50))) == 50


@pytest.mark.parametrize("name", sorted(bundled("units")))
def test_every_unit_that_comes_along_loads(name: str) -> None:
    assert load_unit(name).title


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("rate_hz: 100", "rate_hz: fast", "s.yaml:3: rate_hz: "),
        ("rate_hz: 100", "rate: 100", "s.yaml:3: rate: unknown key"),
        ("unit: crs05", "unit: crs99", "s.yaml:2: unit: no unit 'crs99'; there are athermal, crs05"),
        ("unit: crs05", "unit: {base: crs99}", "s.yaml:2: unit: no unit 'crs99'"),
        ("unit: crs05", "unit: {base: crs05, low_pass_hz: -1}", "s.yaml:2: unit.low_pass_hz: "),
        ("kind: turn", "kind: spin", "s.yaml:8: motion[0]"),
        ("duration_s: 2", "duration_s: 0", "s.yaml:8: motion[0].duration_s: "),
        (
            "{start_degc: 20}",
            "{start_degc: 20, steps: [{to_degc: 5}]}",
            "s.yaml:6: chamber.steps[0]: to_degc and",
        ),
        ("latitude_deg: 45", "latitude_deg: 145", "s.yaml:5: latitude_deg: "),
        ("imumon-scenario/1", "imumon-scenario/2", "s.yaml:1: format: "),
    ],
)
def test_an_error_names_file_line_and_key(tmp_path: Path, old: str, new: str, expected: str) -> None:
    assert expected in refusal(tmp_path / "s.yaml", GOOD.replace(old, new))


def test_three_numbers_or_one_but_nothing_else(tmp_path: Path) -> None:
    for value in ("[1, 2]", "much", "[1, 2, 3, 4]", "true"):
        text = GOOD.replace("crs05", f"{{gyro_lag_s: {value}}}")
        assert "expected a number, or three for x, y and z" in refusal(tmp_path / "s.yaml", text)
    path = tmp_path / "s.yaml"
    path.write_text(GOOD.replace("crs05", "{gyro_lag_s: 3}"))
    assert load_scenario(path).unit.gyro_lag_s == (3, 3, 3)


def test_a_base_gives_what_is_not_stated(tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    path.write_text(
        "format: imumon-scenario/1\nbase: crs05-ramp\nunit: {base: crs05, gyro_lag_s: 5}\nrate_hz: 50\n"
    )
    plan, base = load_scenario(path), load_scenario("crs05-ramp")
    assert plan.chamber == base.chamber
    assert plan.rate_hz == 50
    assert plan.unit.gyro_bias_deg_per_s == base.unit.gyro_bias_deg_per_s
    assert plan.unit.gyro_lag_s == (5, 5, 5)


def test_a_base_of_a_base_is_refused_so_that_no_circle_can_be(tmp_path: Path) -> None:
    path = tmp_path / "s.yaml"
    assert "has a base itself" in refusal(path, f"format: imumon-scenario/1\nbase: {path}\n")


def test_an_error_in_a_unit_names_the_file_of_the_unit(tmp_path: Path) -> None:
    (tmp_path / "u.yaml").write_text("format: imumon-unit/1\ngyro_lag: 3\n")
    seen = refusal(tmp_path / "s.yaml", GOOD.replace("crs05", str(tmp_path / "u.yaml")))
    assert "u.yaml:2: gyro_lag: unknown key" in seen


def test_an_unknown_name_is_answered_with_those_that_there_are() -> None:
    with pytest.raises(ImumonError) as caught:
        load_scenario("crs05-sook")
    assert "crs05-soak" in caught.value.hint


@given(st.text(max_size=40), st.integers(0, 7))
@settings(max_examples=60, deadline=None)
def test_whatever_a_file_holds_it_is_read_or_refused(
    tmp_path_factory: pytest.TempPathFactory, text: str, line: int
) -> None:
    path = tmp_path_factory.mktemp("any") / "s.yaml"
    lines = GOOD.splitlines()
    lines[line] = lines[line].split(":")[0] + ": " + text
    path.write_text("\n".join(lines), encoding="utf-8")
    accepted: Scenario | None = None
    with suppress(ImumonError):  # any other error fails the test
        accepted = load_scenario(path)
    assert accepted is None or accepted.samples >= 1


DOCUMENT = Path(__file__).resolve().parents[3] / "docs" / "simulation.md"


def test_the_example_in_the_documentation_is_a_scenario(tmp_path: Path) -> None:
    example = DOCUMENT.read_text(encoding="utf-8").split("```yaml\n")[1].split("```")[0]
    path = tmp_path / "s.yaml"
    path.write_text(example, encoding="utf-8")
    plan = load_scenario(path)
    assert {event.kind for event in plan.motion} == {"turn", "rotation", "bump", "vibration", "handling"}


def test_the_documentation_names_every_scenario_unit_and_key() -> None:
    text = DOCUMENT.read_text(encoding="utf-8")
    keys = set(UnitParameters.model_fields) - {"format", "title"}
    names = (*bundled("scenarios"), *bundled("units"), *keys)
    assert [name for name in names if f"`{name}`" not in text] == []


def test_the_loop_of_crs05_is_one_and_a_half_percent_of_the_span() -> None:
    soak = np.linspace(-20.53, 48.08, 10_001)
    unit = load_unit("crs05-hysteresis")
    spans = np.ptp(axis_values(unit.gyro_bias_deg_per_s, np.column_stack([soak] * 3)), axis=0)
    assert unit.gyro_hysteresis is not None
    np.testing.assert_allclose(unit.gyro_hysteresis.half_width_deg_per_h, 0.015 * 3600 * spans, atol=0.01)


@pytest.mark.parametrize(
    ("name", "free"),
    [("gyro_x", False), ("device_time_ns", False), ("pressure", True), ("supply_voltage", True)],
)
def test_a_driver_takes_the_place_of_no_column_of_the_unit(tmp_path: Path, name: str, free: bool) -> None:
    path = tmp_path / "mine.yaml"
    driver = f"drivers:\n  {name}: {{unit: V, at_s: [0], value: [5.0]}}\n"
    path.write_text(f"format: imumon-scenario/1\nbase: bench\n{driver}")
    if free:
        assert name in load_scenario(path).drivers
        return
    with pytest.raises(ImumonError, match=f"{name} is a column of the unit itself"):
        load_scenario(path)
