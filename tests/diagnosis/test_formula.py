"""What is outside the library is described by a formula where that predicts the test, else left alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from imumon.blocks import FloatArray
from imumon.diagnosis.engine import diagnose
from imumon.diagnosis.extended import extended_model
from imumon.diagnosis.formula import Node
from imumon.diagnosis.page import write_page
from imumon.diagnosis.report import report
from imumon.effects.base import Drive
from tests.diagnosis.units import lagged, telegraph, three


def strained(time: FloatArray, temperature: FloatArray) -> FloatArray:  # noqa: ARG001 - as all biases
    """A package that any gradient strains: |dT/dt|, °/h for 1.5 °C/min."""
    return 15.0 / 1.5 * 60.0 * np.abs(np.gradient(lagged(temperature, 30.0)))


def test_a_rate_of_either_sign_is_described_and_predicted(tmp_path: Path) -> None:
    diagnosis = diagnose(*three(strained))
    found = report(diagnosis)["channels"]["gyro_x"]
    formula, floor = found["formula"], found["noise_floor_rms"]
    assert [term["of"].partition(",")[0] for term in formula["terms"]] == ["|rate(temperature"]
    assert formula["test_rms_without"] > 2.5 * floor
    assert formula["test_rms_with"] < 1.3 * floor
    assert found["unexplained"]  # a description is no explanation
    assert "a description, no cause" in found["summary"]
    assert not any(effect["name"] == "formula" for effect in found["effects"])
    assert all(effect.name != "formula" for effect in extended_model(diagnosis).channels["gyro_x"].effects)
    write_page(diagnosis, tmp_path / "report.html")
    assert "|rate(temperature, " in (tmp_path / "report.html").read_text(encoding="utf-8")


def test_what_nothing_predicts_stays_unexplained() -> None:
    found = report(diagnose(*three(telegraph)))["channels"]["gyro_x"]
    assert found["effects"] == []
    assert found["unexplained"]
    assert found["formula"] is None
    assert "describes" not in found["summary"]


def test_no_operator_looks_ahead() -> None:
    time = np.arange(600.0)
    driver = np.sin(time / 40.0)
    signal = Node("signal", name="driver")
    rate = Node("rate", (signal,), 15.0)
    for node in (
        rate,
        Node("lag", (signal,), 60.0),
        Node("loop", (signal,), 0.3),
        Node("leak", (Node("product", (signal, rate)),), 60.0),
        Node("size", (rate,)),
        Node("power", (signal,), 2.0),
    ):
        whole, part = (
            node.values(Drive(time[:n], np.zeros(n), None, {"driver": driver[:n]})) for n in (600, 400)
        )
        np.testing.assert_array_equal(whole[:400], part)


def test_operators_are_what_their_names_say() -> None:
    time = np.arange(6000.0)
    drive = Drive(time, np.zeros(6000), None, {"ramp": time / 60.0, "one": np.ones(6000)})
    ramp, one = Node("signal", name="ramp"), Node("signal", name="one")
    np.testing.assert_allclose(Node("rate", (ramp,), 15.0).values(drive)[300:], 1.0, atol=1e-6)
    leak = Node("leak", (one,), 600.0).values(drive)
    np.testing.assert_allclose(leak, 1.0 - np.exp(-time / 600.0), atol=1e-9)
    np.testing.assert_allclose(Node("loop", (ramp,), 0.3).values(drive)[60:], ramp.values(drive)[60:] - 0.3)
    assert str(Node("leak", (Node("size", (Node("rate", (ramp,), 15.0),)),), 600.0)) == (
        "leak(|rate(ramp, 15 s)|, 600 s)"
    )
