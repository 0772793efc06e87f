"""The loop closed live: a unit lacks an effect in its model, on a pseudo-terminal where time runs fast."""

from __future__ import annotations

import json
import os
import re
import signal
import subprocess
import tty
from pathlib import Path

import numpy as np
import pytest

from imumon.geodesy import DEG_PER_H
from imumon.lab.diagnosis.runs import Run, collect
from imumon.models.curves.points import Points
from imumon.models.curves.polynomial import fit_polynomial
from imumon.models.model import BiasModel, ChannelModel, load_model
from imumon.protocols.device import device_text, load_device, parse_device
from imumon.simulation.recording import record_session
from imumon.simulation.unit import SimulatedUnit, load_scenario
from imumon.simulation.unit.scenario import Scenario
from imumon.simulation.unit.unit import MICROSECOND
from tests.cli.command import IMUMON, answer, imumon
from tests.fleet.batch.sessions import tiny
from tests.waiting import unread, wait_until

RATE_HZ, SECONDS, LAG_S = 5.0, 1950, 90.0
PIECE = 1024
AXES = "xyz"


def scenario(start_degc: float, *ends_degc: float) -> Scenario:
    base = load_scenario("crs05-ramp-lag")
    steps = [{"hold_s": 200}, *({"to_degc": end, "rate_degc_per_min": 2, "hold_s": 200} for end in ends_degc)]
    chamber = {**base.chamber.model_dump(), "start_degc": start_degc, "steps": steps}
    unit = {**base.unit.model_dump(), "gyro_lag_s": LAG_S}
    said = {**base.model_dump(), "rate_hz": RATE_HZ, "duration_s": SECONDS, "chamber": chamber, "unit": unit}
    return Scenario.model_validate(said)


def run(seed: int, *ends_degc: float) -> Run:
    return collect([SimulatedUnit(scenario(*ends_degc), seed).run(int(SECONDS * RATE_HZ))[0]], "run")[0]


@pytest.fixture(scope="module")
def present(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a model with curves alone, which were fitted with the lag in them."""
    channels, train = {}, run(1, 25.0, 45.0, 10.0, 40.0)
    for axis in AXES:
        t, y = train.mean[f"temperature_{axis}"], train.mean[f"gyro_{axis}"]
        points = Points(t, y, np.ones(len(t)), np.zeros(len(t), np.int64))
        channels[f"gyro_{axis}"] = ChannelModel(
            unit="rad/s",
            temperature_column=f"temperature_{axis}",
            temperature_range_degc=[float(t.min()), float(t.max())],
            residual_sd=20.0 * DEG_PER_H,
            curve=fit_polynomial(points, 5),
        )
    path = tmp_path_factory.mktemp("models") / "present.yaml"
    BiasModel(made_by="a test", created="2026-01-01T00:00:00Z", channels=channels).write(path)
    return path


def packets(seed: int, *ends_degc: float) -> bytes:
    device = load_device("ax1")
    tick_ns = device.decoder().timing.tick_ns or MICROSECOND
    unit = SimulatedUnit(scenario(*ends_degc).played(RATE_HZ, device.axes), seed, tick_ns)
    return b"".join(device.encoder().encode(unit.samples(int(SECONDS * RATE_HZ))))


def send(master: int, data: bytes) -> None:
    """Write to a pseudo-terminal, which takes as much as the host reads: the device's time runs that fast."""
    while data:
        data = data[os.write(master, data[:PIECE]) :]


@pytest.mark.long
def test_a_lacking_model_is_warned_of_learned_live_and_the_next_session_is_better_by_as_much(
    present: Path, tmp_path: Path
) -> None:
    text, source = device_text("ax1")
    slow = text.replace("rate_hz: 100", f"rate_hz: {RATE_HZ:g}")
    (tmp_path / "slow.yaml").write_text(slow, encoding="utf-8")
    session = tmp_path / "sessions" / "first"
    master, slave = os.openpty()
    tty.setraw(slave)
    given = ("--device", tmp_path / "slow.yaml", "--view", "none", "--out", session, "--learn")
    command = [IMUMON, "monitor", os.ttyname(slave), *given, "--model", present]
    data = packets(2, 25.0, 35.0, 25.0, 35.0, 25.0, 35.0)
    with subprocess.Popen([*map(str, command)], stderr=subprocess.PIPE, text=True) as monitor:
        send(master, data)
        assert wait_until(lambda: not unread(slave))
        monitor.send_signal(signal.SIGINT)
        said = monitor.communicate()[1]
    os.close(master)
    os.close(slave)
    assert monitor.returncode == 0, said
    assert re.search(r"MODEL CAN BE BETTER: .*thermal_lag.* on x, y", said), said
    assert "imumon diagnose --train SESSION --model SESSION" in said
    won = re.search(r"has won on what came later: ([\d.]+) become ([\d.]+) °/h", said)
    assert won is not None, said
    learned = session / "learned-model.yaml"
    assert load_model(learned).trained_on[-1].session == "first"
    device, next_one = parse_device(text, source), session.with_name("next")
    plan = scenario(25.0, 35.0, 25.0, 35.0).model_copy(update={"duration_s": 1200.0})
    plan = plan.played(RATE_HZ, device.axes)
    record_session(plan, device, text, 3, next_one, lambda _: None)
    page = tmp_path / "compared.html"
    done = imumon("replay", next_one, "--compare-models", session, learned, "--out", page, "--json")
    assert re.search(r"gyro_x +[\d.]+ become [\d.]+ °/h rms", done.stderr), done.stderr
    found = json.loads(done.stdout)
    assert "Before and after" in page.read_text(encoding="utf-8")
    before, after = np.transpose(list(found["rms"].values()))
    stated = [float(value) * DEG_PER_H for value in won.groups()]
    # Of x and y, which it is stated of.
    assert np.hypot(*before[:2]) - np.hypot(*after[:2]) > 0.8 * np.sqrt(2.0) * (stated[0] - stated[1])
    # All sessions of the unit say the same, with the latest as the test.
    better = tmp_path / "better.yaml"
    report = answer("learn", session.parent, "--model", session, "--out", better)
    channel = report["channels"]["gyro_x"]
    assert channel["after"]["test_rms"] < 0.5 * channel["before"]["test_rms"]
    named = {one["name"] for one in channel["effects"]}
    assert "thermal_lag" in named.union(*channel["indistinguishable"])
    assert load_model(better).channels["gyro_x"].effects


def test_learning_without_a_model_and_from_no_sessions_is_refused(tmp_path: Path) -> None:
    done = imumon("monitor", tmp_path / "port", "--device", "ax1", "--view", "none", "--learn")
    assert done.returncode == 2
    assert "--learn: there is no bias model" in done.stderr
    done = imumon("learn", tmp_path, "--out", tmp_path / "model.yaml")
    assert done.returncode == 4
    assert "there is no session" in done.stderr
    done = imumon("replay", tmp_path, "--compare-models", "a.yaml", "b.yaml")
    assert done.returncode == 2
    assert "--out PAGE.html" in done.stderr


def test_sessions_of_several_units_are_not_one(tmp_path: Path, present: Path) -> None:
    for name, serial in (("a", "SN1"), ("b", "SN2"), ("c", "null")):
        metadata = tiny(tmp_path / "lab" / name) / "session.yaml"
        metadata.write_text(metadata.read_text().replace("serial: null", f"serial: {serial}"))
    given = ("learn", tmp_path / "lab", "--out", tmp_path / "model.yaml")
    done = imumon(*given)
    assert done.returncode == 2
    assert "has sessions of serial SN1, SN2" in done.stderr
    assert "--serial NAME" in done.stderr
    done = imumon(*given, "--serial", "SN3")
    assert "there is no session of serial SN3" in done.stderr
    other = tmp_path / "of-another.yaml"
    other.write_text(present.read_text().replace("serial: null", "serial: SN2"))
    done = imumon(*given, "--serial", "SN1", "--model", other)
    assert "the bias model is of unit SN2, this is SN1" in done.stderr
    assert "a is left out" in done.stderr
    assert "b is left out" not in done.stderr
    done = imumon("replay", tmp_path / "lab" / "a", "--model", other)
    assert "the bias model is of unit SN2, this is SN1" in done.stderr
