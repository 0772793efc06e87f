"""What a bias model lacks: named where the data show it, proven on unseen data, and not named otherwise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imumon.blocks import ColumnArray, FloatArray, SampleBlock
from imumon.columns import KNOWN
from imumon.errors import ImumonError, Reason
from imumon.lab.diagnosis.diagnose import Diagnosis, diagnose
from imumon.lab.diagnosis.extended import extended_model
from imumon.lab.diagnosis.report import report
from imumon.lab.diagnosis.runs import Origin, Run, read_runs
from imumon.models.curves.points import Points
from imumon.models.curves.polynomial import PolynomialCurve, fit_polynomial
from imumon.models.curves.spline import SplineCurve
from imumon.models.model import BiasModel, ChannelModel, load_model
from imumon.models.predictor import BiasPredictor
from imumon.protocols.device import device_text, parse_device
from imumon.recordings.table import TableWriter
from imumon.simulation.recording import record_session
from imumon.simulation.unit import load_scenario
from tests.data_folder import measured
from tests.estimation.attitude.test_stage import CALIBRATED
from tests.lab.diagnosis.units import DPH, WHITE_DPH, Bias, cubic, lagged, ramps, run, three

LAG_S = 200.0
SHORT_S = 2400
"""Enough where what is found does not matter."""


def lag(time: FloatArray, temperature: FloatArray) -> FloatArray:  # noqa: ARG001 - as all biases
    return 5.0 * (temperature - lagged(temperature, LAG_S))


def nothing(time: FloatArray, temperature: FloatArray) -> FloatArray:  # noqa: ARG001 - as all biases
    return np.zeros_like(time)


@pytest.fixture(scope="module")
def lagging() -> Diagnosis:
    return diagnose(*three(lag))


@pytest.fixture(scope="module")
def complete() -> Diagnosis:
    return diagnose(*three(nothing))


def names(diagnosis: Diagnosis) -> list[str]:
    return [claim.finding.name for verdict in diagnosis.verdicts for claim in verdict.claims]


def test_a_lag_is_named_with_its_time_constant_and_proven_on_the_test(lagging: Diagnosis) -> None:
    found = report(lagging)["channels"]["gyro_x"]
    assert [effect["name"] for effect in found["effects"]] == ["thermal_lag"]
    assert found["effects"][0]["parameters"]["time_constant_s"] == pytest.approx(LAG_S, rel=0.1)
    floor = found["noise_floor_rms"]
    assert floor == pytest.approx(WHITE_DPH * DPH, rel=0.05)
    assert found["before"]["test_rms"] > 3 * floor
    assert found["after"]["test_rms"] < 1.2 * floor
    assert not found["unexplained"]


def creeping(time: FloatArray, temperature: FloatArray) -> FloatArray:  # noqa: ARG001 - as all biases
    """Stress that creeps away through many barriers, from seconds to days."""
    return np.asarray(60.0 * np.exp(-time[:, np.newaxis] / np.logspace(0.5, 5.0, 40)).mean(axis=1))


def late(time: FloatArray, temperature: FloatArray) -> FloatArray:
    return np.asarray(5.0 * (temperature - np.interp(time - 150.0, time, temperature)))


@pytest.mark.parametrize(("bias", "name"), [(creeping, "stress_relaxation"), (late, "dead_time")])
def test_a_creep_and_a_dead_time_are_named_as_such_and_carry_over(bias: Bias, name: str) -> None:
    diagnosis = diagnose(*three(bias))
    found = report(diagnosis)["channels"]["gyro_x"]
    assert [effect["name"] for effect in found["effects"]] == [name]
    assert not found["unexplained"]
    assert found["before"]["test_rms"] > 2.5 * found["noise_floor_rms"]
    assert found["after"]["test_rms"] < 1.2 * found["noise_floor_rms"]
    assert [effect.name for effect in extended_model(diagnosis).channels["gyro_x"].effects] == [name]


def late_curve(time: FloatArray, temperature: FloatArray) -> FloatArray:  # noqa: ARG001 - as all biases
    """A bent curve, all of it over the temperature of a while ago and nothing over that of now."""
    return np.asarray(bent(lagged(temperature, LAG_S)) - cubic(temperature))


def bent(temperature: FloatArray) -> FloatArray:
    return np.asarray(60.0 * np.tanh((temperature - 22.0) / 6.0) + 0.5 * temperature)


@pytest.mark.long
def test_a_curve_that_is_itself_late_is_a_lag_with_the_powers_that_it_needs() -> None:
    diagnosis = diagnose(*three(late_curve, 4000))
    found = report(diagnosis)["channels"]["gyro_x"]
    floor = found["noise_floor_rms"]
    assert [effect["name"] for effect in found["effects"]] == ["thermal_lag"]
    time_constant_s, _ = found["effects"][0]["parameters"]["time_constant_s"]  # beside the further powers
    assert time_constant_s == pytest.approx(LAG_S, rel=0.05)
    assert found["before"]["test_rms"] > 5 * floor
    assert found["after"]["test_rms"] < 1.2 * floor
    assert not found["unexplained"]
    # The curve of the model file is that of equilibrium, with its own sigma.
    assert len(found["curve"]["sigma"]) == len(found["curve"]["coefficients"])
    at = np.linspace(13.0, 39.0, 27)
    curve = extended_model(diagnosis).channels["gyro_x"].curve.value(at)
    assert curve == pytest.approx(bent(at) * DPH, abs=3 * floor)


def late_and_loose(time: FloatArray, temperature: FloatArray) -> FloatArray:
    """A lag and a loop of one sign, which have most of their course in common."""
    loop = np.empty_like(temperature)
    at = temperature[0]
    for i, value in enumerate(temperature.tolist()):
        at = loop[i] = min(max(at, value - 3.0), value + 3.0)
    return lag(time, temperature) + 6.0 * (temperature - loop)


@pytest.mark.long
def test_a_lag_and_a_loop_are_both_named() -> None:
    diagnosis = diagnose(*three(late_and_loose))
    found = report(diagnosis)["channels"]["gyro_x"]
    assert sorted(names(diagnosis)) == ["hysteresis", "thermal_lag"]
    assert found["before"]["test_rms"] > 5 * found["noise_floor_rms"]
    assert found["after"]["test_rms"] < 1.3 * found["noise_floor_rms"]


def test_the_model_file_predicts_the_test_as_well_as_the_report_states(
    lagging: Diagnosis, tmp_path: Path
) -> None:
    path = tmp_path / "model.yaml"
    extended_model(lagging).write(path)
    model = load_model(path)
    test = three(lag)[1][0]
    n = len(test.time_s)
    predicted = BiasPredictor(model, ["gyro_x"]).process(
        np.round(test.time_s * 1e9).astype(np.int64),
        np.zeros(n, np.int64),
        test.mean["temperature"][:, np.newaxis],
    )
    left = (
        (test.mean["gyro_x"] - predicted.bias[:, 0])[900 : 900 + 30 * ((n - 900) // 30)]
        .reshape(-1, 30)
        .mean(1)
    )
    score = lagging.verdicts[0].test_after
    assert score is not None
    assert float(np.sqrt(np.mean(left**2))) == pytest.approx(score.rms, rel=0.1)
    assert [effect.name for effect in model.channels["gyro_x"].effects] == ["thermal_lag"]


def test_where_nothing_is_missing_nothing_is_named(complete: Diagnosis) -> None:
    verdict = complete.verdicts[0]
    assert names(complete) == []
    assert not verdict.unexplained
    assert extended_model(complete).channels["gyro_x"].effects == []


@pytest.mark.parametrize(("value", "said"), [(3.0, "saturated for 600 s"), (1e3, "saturated for 600 s")])
def test_a_channel_that_stands_still_is_a_fault_and_no_effect(value: float, said: str) -> None:
    train, test = three(nothing)
    mean, variance = train[0].mean["gyro_x"].copy(), train[0].variance["gyro_x"].copy()
    mean[1000:1600], variance[1000:1600] = value * DPH, 0.0
    train[0] = replace(
        train[0], mean={**train[0].mean, "gyro_x": mean}, variance={**train[0].variance, "gyro_x": variance}
    )
    diagnosis = diagnose(train, test)
    assert any(said in text for text in diagnosis.caveats)
    assert names(diagnosis) == []
    assert diagnosis.verdicts[0].summary.startswith("nothing is missing")


def test_digits_coarser_than_the_noise_are_reported() -> None:
    train, test = three(nothing, SHORT_S)
    step = 200 * WHITE_DPH * DPH
    coarse = [replace(r, mean={**r.mean, "gyro_x": np.round(r.mean["gyro_x"] / step) * step}) for r in train]
    coarse = [replace(r, variance={"gyro_x": np.zeros(len(r.time_s))}) for r in coarse]
    coarse[1].mean["gyro_x"][::100] += step
    assert any("too few digits" in text for text in diagnose(coarse, test).caveats)


def with_supply(train: list[Run], test: list[Run], sensitive: float) -> tuple[list[Run], list[Run]]:
    """Return runs with a supply that is switched, on which the gyro depends by so many °/h per 0.1 V."""
    found = []
    for at, one in enumerate((*train, *test)):
        random = np.random.default_rng(at)
        level = random.normal(size=1 + int(one.time_s[-1] // 400))[(one.time_s // 400).astype(int)]
        supply = 5.0 + 0.1 * level + 0.002 * random.standard_normal(len(level))
        gyro = one.mean["gyro_x"] + sensitive * level * DPH
        found.append(replace(one, mean={**one.mean, "supply_voltage": supply, "gyro_x": gyro}))
    return found[:2], found[2:]


@pytest.mark.long
def test_a_recorded_driver_is_named_and_goes_into_the_model_file(tmp_path: Path) -> None:
    train, test = with_supply(*three(nothing), 8.0)
    diagnosis = diagnose(train, test)
    assert names(diagnosis) == ["curve(supply_voltage)"]
    score = diagnosis.verdicts[0].test_after
    assert score is not None
    assert score.rms < 1.2 * diagnosis.verdicts[0].channel.floor.sd
    extended_model(diagnosis).write(tmp_path / "model.yaml")
    model = load_model(tmp_path / "model.yaml")
    # What knows the driver lacks nothing more; without it, the supply, nothing explains the rest.
    assert names(diagnose(train, test, model=model)) == []
    alone = diagnose(train, test, drivers=[])
    assert not any("supply" in name for name in names(alone))
    predictor = BiasPredictor(model, ["gyro_x"])
    assert predictor.drivers == ("supply_voltage",)


@pytest.mark.long
def test_a_driver_that_does_nothing_is_not_named_and_one_that_is_not_there_is_refused() -> None:
    train, test = with_supply(*three(lag), 0.0)
    assert names(diagnose(train, test)) == ["thermal_lag"]
    with pytest.raises(ImumonError, match="load is not in the training data"):
        diagnose(train, test, drivers=["load"])


@pytest.mark.long
def test_what_only_the_test_shows_is_not_called_nothing(complete: Diagnosis) -> None:
    train, test = three(nothing)
    shifted = test[0].mean["gyro_x"] + 3 * WHITE_DPH * DPH
    other = [replace(test[0], mean={**test[0].mean, "gyro_x": shifted})]
    assert complete.verdicts[0].summary.startswith("nothing is missing")
    said = [diagnose(train, each).verdicts[0].summary for each in (other, [])]
    assert said[0].startswith("nothing is proven")
    assert "without a test" in said[1]


def test_the_recording_that_was_trained_on_is_no_test() -> None:
    train, _ = three(nothing, SHORT_S)
    train[0] = replace(train[0], origin=Origin("first", 0, "0" * 64))
    copy = replace(train[0], name="copy", origin=Origin("copy", 0, "0" * 64))
    diagnosis = diagnose(train, [copy])
    assert not diagnosis.test
    assert any("the training has the same recording" in text for text in diagnosis.caveats)


def test_of_a_single_run_every_other_stretch_is_the_test_and_that_is_reported() -> None:
    whole = run(4, *ramps(7200, up=True), lag)
    diagnosis = diagnose([whole], [])
    assert diagnosis.held_out
    assert not report(diagnosis)["independent_test"]
    assert any("weaker than another power-on" in text for text in diagnosis.caveats)
    verdict = diagnosis.verdicts[0]
    assert verdict.test_before is not None
    assert verdict.test_after is not None
    assert "thermal_lag" in verdict.claims[0].finding.names
    assert verdict.test_after.rms < 0.5 * verdict.test_before.rms


@pytest.mark.long
@pytest.mark.parametrize(
    ("rate", "hours", "gap_s"),
    [(0.01, 30.0, 0.3), (0.2, 2.0, 0.3), (0.9, 1.0, 0.0), (10.0, 0.4, 0.3)],
)
def test_any_log_will_do(rate: float, hours: float, gap_s: float, tmp_path: Path) -> None:
    found = []
    for seed in (1, 2, 3):
        random = np.random.default_rng(seed)
        time = np.arange(int(hours * 3600 * rate)) / rate
        if gap_s:  # of each hundred samples about thirty are lost, one piece at a time
            time = time[np.arange(len(time)) % 100 >= 100 * gap_s * random.random()]
        seconds = np.arange(0.0, hours * 3600)
        corners = np.array([0, 0.25, 0.4, 0.75, 0.9, 1.0]) * hours * 3600
        course = np.interp(
            seconds, corners, [25, 42, 42, 12, 12, 18] if seed % 2 else [25, 10, 10, 40, 40, 30]
        )
        late = lagged(course, LAG_S if rate > 0.1 else 2000.0)
        behind = np.interp(time, seconds, course - late)
        temperature = np.interp(time, seconds, course)
        columns: dict[str, ColumnArray] = {"device_time_ns": np.round(time * 1e9).astype(np.int64)}
        sd = 0.3 * 60 * np.sqrt(rate)
        noise = sd * random.standard_normal(len(time))
        columns["gyro_x"] = (cubic(temperature) + 8.0 * behind + noise) * DPH
        for axis, force in zip("xyz", (0.0, 0.1, 9.8), strict=True):
            columns[f"accel_{axis}"] = force + 0.002 * random.standard_normal(len(time))
        columns["temperature"] = temperature
        with TableWriter(tmp_path / f"{seed}.parquet", {name: KNOWN[name] for name in columns}) as writer:
            writer.write(SampleBlock(columns))
        found += read_runs(tmp_path / f"{seed}.parquet")
    diagnosis = diagnose(found[:2], found[2:], sensors=("gyro",))
    finding = diagnosis.verdicts[0].claims[0].finding
    assert "thermal_lag" in finding.names
    score = diagnosis.verdicts[0].test_after
    assert score is not None
    assert score.rms < 1.3 * diagnosis.verdicts[0].channel.floor.sd


def test_a_jump_is_named_estimated_in_the_test_and_left_out_of_the_model_file() -> None:
    def jump(time: FloatArray, temperature: FloatArray) -> FloatArray:  # noqa: ARG001 - as all biases
        return np.where(time > 1700.0, 15.0, 0.0)

    diagnosis = diagnose(*three(jump))
    verdict = diagnosis.verdicts[0]
    assert set(names(diagnosis)) == {"step"}
    assert verdict.test_before is not None
    assert verdict.test_after is not None
    assert verdict.prediction is verdict.test_before
    assert verdict.test_after.estimated_rms < 1.2 * verdict.channel.floor.sd
    assert extended_model(diagnosis).channels["gyro_x"].effects == []


@pytest.mark.long
def test_a_known_model_is_taken_off_first_and_goes_into_the_file_with_what_it_lacked() -> None:
    knots = np.linspace(5.0, 45.0, 30)
    curve = SplineCurve(
        knots_degc=knots.tolist(),
        values=(cubic(knots) * DPH).tolist(),
        slopes=(np.gradient(cubic(knots) * DPH, knots)).tolist(),
    )
    channel = ChannelModel(
        unit="rad/s",
        temperature_column="temperature_estimate",
        temperature_range_degc=[5.0, 45.0],
        residual_sd=1e-6,
        curve=curve,
    )
    known = BiasModel(
        made_by="a test",
        created="2026-01-01T00:00:00Z",
        channels={"gyro_x": channel},
        magnetometer=CALIBRATED,
    )
    diagnosis = diagnose(*three(lag), model=known)
    assert names(diagnosis) == ["thermal_lag"]
    assert extended_model(diagnosis).magnetometer == CALIBRATED
    found = extended_model(diagnosis).channels["gyro_x"]
    assert found.curve.kind == "spline"
    assert found.temperature_column == "temperature_estimate"
    assert [effect.name for effect in found.effects] == ["thermal_lag"]
    # What now knows the lag lacks nothing more.
    again = diagnose(*three(lag), model=extended_model(diagnosis))
    assert names(again) == []
    assert not again.verdicts[0].unexplained


def test_a_known_model_of_other_temperatures_is_refused_before_the_search() -> None:
    channel = ChannelModel(
        unit="rad/s",
        temperature_column="temperature",
        temperature_range_degc=[-20.0, -0.5],
        residual_sd=1e-6,
        curve=PolynomialCurve(center_degc=-10.25, half_width_degc=9.75, coefficients=[0.0, 1e-5]),
    )
    known = BiasModel(made_by="a test", created="2026-01-01T00:00:00Z", channels={"gyro_x": channel})
    done: list[str] = []
    with pytest.raises(
        ImumonError, match=r"from -20.00 to -0.50 °C.*has 1\d\.\d\d to \d\d\.\d\d °C"
    ) as error:
        diagnose(*three(lag), progress=done.append, model=known)
    assert error.value.reason is Reason.BAD_CONFIG
    assert "--model" in error.value.hint
    assert done == []


@pytest.mark.long
def test_a_curve_that_was_fitted_with_the_effect_in_it_is_fitted_anew_until_nothing_is_found() -> None:
    def strong(time: FloatArray, temperature: FloatArray) -> FloatArray:
        return 8.0 * lag(time, temperature)

    train, test = three(strong)
    t, y = (np.concatenate([one.mean[name] for one in train]) for name in ("temperature", "gyro_x"))
    points = Points(t, y, np.ones(len(t)), np.zeros(len(t), np.int64))
    channel = ChannelModel(
        unit="rad/s",
        temperature_column="temperature",
        temperature_range_degc=[11.9, 40.1],
        residual_sd=1e-6,
        curve=fit_polynomial(points, 5),
    )
    model = BiasModel(made_by="a test", created="2026-01-01T00:00:00Z", channels={"gyro_x": channel})
    left, found = [], []
    for _ in range(2):
        diagnosis = diagnose(train, test, model=model)
        verdict = diagnosis.verdicts[0]
        assert verdict.test_after is not None
        left.append(verdict.test_after.rms / verdict.channel.floor.sd)
        found.append(names(diagnosis))
        model = extended_model(diagnosis)
        steps = report(diagnosis)["channels"]["gyro_x"]["turns"]
        if len(left) == 1:
            assert steps[0]["test_rms"] > 10 * steps[-1]["test_rms"]
    assert found == [["thermal_lag"], []]
    assert max(left) < 1.3


def test_a_test_that_goes_on_where_training_ended_takes_lag_and_time_with_it() -> None:
    time, temperature = ramps(9000, up=True)
    whole = run(4, time, temperature, lag)
    first = replace(_part(whole, 0, 6050), start_ns=7_000_000_000)
    last = replace(_part(whole, 6050, 9000), start_ns=6057_000_000_000)
    together = diagnose([first], [last])
    apart = diagnose([first], [replace(last, start_ns=0)])
    assert any("goes on where" in text for text in together.caveats)
    assert not any("goes on where" in text for text in apart.caveats)
    assert names(together)
    score = together.verdicts[0].test_after
    assert score is not None
    assert score.rms < 1.3 * together.verdicts[0].channel.floor.sd
    assert score.predicted_residual[0][0] == pytest.approx(0.0, abs=5 * WHITE_DPH * DPH)


def test_a_jump_stays_where_the_test_goes_on_and_is_no_part_of_the_model_file() -> None:
    def jump(time: FloatArray, temperature: FloatArray) -> FloatArray:  # noqa: ARG001 - as all biases
        return np.where(time > 3700.0, 12.0, 0.0)

    whole = run(4, *ramps(9000, up=True), jump)
    first = replace(_part(whole, 0, 6050), start_ns=7_000_000_000)
    last = replace(_part(whole, 6050, 9000), start_ns=6057_000_000_000)
    diagnosis = diagnose([first], [last])
    assert names(diagnosis) == ["step"]
    before, after = diagnosis.verdicts[0].test_before, diagnosis.verdicts[0].prediction
    assert before is not None
    assert after is not None
    assert before.rms > 2.5 * diagnosis.verdicts[0].channel.floor.sd
    assert after.rms < 1.2 * diagnosis.verdicts[0].channel.floor.sd
    assert not diagnosis.verdicts[0].predicts
    assert extended_model(diagnosis).channels["gyro_x"].effects == []


@pytest.fixture(scope="module")
def chamber_cycle() -> Run:
    folder = measured("chamber-cycle")
    return read_runs(folder / "cooling-heating.csv", folder / "map.yaml")[0]


@pytest.mark.long
def test_what_is_found_in_a_measured_run_hangs_on_no_block_and_on_no_boundary_of_blocks(
    chamber_cycle: Run,
) -> None:
    whole, n = chamber_cycle, len(chamber_cycle.time_s)
    at = int(0.65 * n)

    def found(first: int, lost: int) -> tuple[list[str], float, float]:
        train = replace(_part(whole, first, at), start_ns=first * 10**9)
        train.rest[lost : lost + 30] = 0.0
        test = replace(_part(whole, at, n), start_ns=at * 10**9)
        verdict = diagnose([train], [test], sensors=("gyro_x",)).verdicts[0]
        assert verdict.test_before is not None
        assert verdict.test_after is not None
        said = [claim.finding.name for claim in verdict.claims]
        return said, verdict.test_before.rms, verdict.prediction.rms

    for first, lost in [(0, 30 * block) for block in range(0, at // 30, 200)] + [(7, 0), (23, 0)]:
        said, before, after = found(first, lost)
        assert "step" in said, (first, lost)
        assert after < 0.55 * before, (first, lost)


def test_a_lag_gives_way_to_no_loop_that_was_found_before_the_jump_beside_it(
    chamber_cycle: Run,
) -> None:
    again = replace(chamber_cycle, name="the same course later", start_ns=10**13)
    diagnosis = diagnose([chamber_cycle], [again], sensors=("gyro",))
    verdict = diagnosis.verdicts[0]
    lag, jump = (claim.finding for claim in verdict.claims)
    assert (lag.name, jump.name) == ("thermal_lag", "step")
    assert lag.candidate.free_start
    *_, before, last = report(diagnosis)["channels"]["gyro_x"]["turns"]
    assert last["done"] == "thermal_lag fits better beside the rest"
    for rms in ("train_rms", "test_rms"):
        assert last[rms] < 0.7 * before[rms]


def _part(whole: Run, start: int, stop: int) -> Run:
    def cut(parts: dict[str, FloatArray]) -> dict[str, FloatArray]:
        return {name: values[start:stop] for name, values in parts.items()}

    return Run(
        f"part from {start}",
        np.arange(stop - start, dtype=np.float64) + 0.5,
        cut(whole.count),
        cut(whole.mean),
        cut(whole.variance),
        whole.rest[start:stop].copy(),
    )


def test_at_constant_temperature_no_effect_of_temperature_is_claimed() -> None:
    def drift(time: FloatArray, temperature: FloatArray) -> FloatArray:  # noqa: ARG001 - as all biases
        return np.asarray(time / 300.0)

    time = np.arange(5000, dtype=np.float64) + 0.5
    diagnosis = diagnose([run(seed, time, np.full(5000, 25.0), drift) for seed in (1, 2)], [])
    assert any("no effect of temperature can be found" in text for text in diagnosis.caveats)
    assert any("there is no independent proof" in text for text in diagnosis.caveats)
    assert names(diagnosis) == ["drift"]


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda r: _part(r, 0, 900), "too short"),
        (lambda r: replace(r, rest=np.zeros_like(r.rest)), "the unit moves"),
        (
            lambda r: replace(r, mean={k: v for k, v in r.mean.items() if k != "temperature"}),
            "no temperature",
        ),
        (lambda r: replace(r, mean={"temperature": r.mean["temperature"]}), "no channel of gyro, accel"),
    ],
)
def test_data_that_cannot_show_anything_are_refused_in_words(change, said: str) -> None:  # type: ignore[no-untyped-def]  # a lambda
    with pytest.raises(ImumonError, match=said):
        diagnose([change(three(nothing)[0][0])], [])


def test_a_log_of_few_samples_has_blocks_that_show_its_noise() -> None:
    def every_20_s(one: Run) -> Run:
        mean = {name: values.reshape(-1, 20).mean(1) for name, values in one.mean.items()}
        n = len(one.time_s) // 20
        count, variance = dict.fromkeys(mean, np.ones(n)), dict.fromkeys(one.variance, np.full(n, np.nan))
        time_s = np.arange(10.0, 20.0 * n, 20.0)
        return replace(
            one, time_s=time_s, count=count, mean=mean, variance=variance, rest=np.ones(n), slot_s=20.0
        )

    train, test = three(lag, 7200)
    diagnosis = diagnose([every_20_s(one) for one in train], [every_20_s(one) for one in test])
    assert names(diagnosis) == ["thermal_lag"]


def test_gaps_are_left_out_and_reported() -> None:
    train, test = three(lag)
    holes = train[0].mean["gyro_x"].copy()
    samples = train[0].count["gyro_x"].copy()
    holes[1000:1840], samples[1000:1840] = np.nan, 0.0
    mean, count = {**train[0].mean, "gyro_x": holes}, {**train[0].count, "gyro_x": samples}
    train[0] = replace(train[0], mean=mean, count=count)
    diagnosis = diagnose(train, test)
    assert any("65% of its time" in text for text in diagnosis.caveats)
    assert "thermal_lag" in names(diagnosis)


@pytest.mark.parametrize(("field", "warned"), [("Imu.UncompGyro", False), ("Common.AngRate", True)])
def test_rates_that_the_device_has_corrected_are_reported(field: str, warned: bool, tmp_path: Path) -> None:
    text, source = device_text("vectornav")
    sends = f"sends: [Common.TimeStartup, {field}, Imu.Temperature]"
    text = "\n".join(sends if line.startswith("sends:") else line for line in text.splitlines())
    scenario = load_scenario("bumps-and-fan").model_copy(update={"duration_s": 320.0, "rate_hz": 20.0})
    record_session(scenario, parse_device(text, source), text, 1, tmp_path / "session", lambda _: None)
    runs = read_runs(tmp_path / "session")
    assert any("UncompGyro" in said for said in runs[0].warnings) is warned
    train, test = three(nothing, SHORT_S)
    train[0] = replace(train[0], warnings=runs[0].warnings)
    caveats = diagnose(train, test).caveats
    assert sum("UncompGyro" in said for said in caveats) == warned


def test_what_each_run_is_left_with_is_that_of_the_model_which_predicts() -> None:
    """Without a model that carries over, it is the declared one: the report had both."""
    runs = [run(seed, *ramps(SHORT_S, up=bool(seed % 2)), nothing) for seed in (1, 2)]
    jumps = run(3, *ramps(SHORT_S, up=True), lambda time, _: np.where(time > 1300.0, 40.0, 0.0))
    diagnosis = diagnose([runs[0], jumps], [runs[1]])
    assert names(diagnosis) == ["step"]
    assert not diagnosis.verdicts[0].predicts
    found = report(diagnosis)["channels"]["gyro_x"]
    (test,) = (row for row in found["runs"] if row["test"])
    assert test["after"] == pytest.approx(found["after"]["test_rms"])
