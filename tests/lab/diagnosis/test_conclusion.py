"""What a person reads first: the conclusion, the proof, the next step; and that nothing is named that the
test does not show."""

from __future__ import annotations

import inspect
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from imumon.lab.calibration.cells import ONE_WAY
from imumon.lab.diagnosis.candidates import Finding
from imumon.lab.diagnosis.diagnose import Diagnosis, diagnose
from imumon.lab.diagnosis.page import write_page
from imumon.lab.diagnosis.report import conclusion, next_step, report
from imumon.lab.diagnosis.runs import Run
from imumon.lab.diagnosis.search import PROVEN_GAIN
from imumon.lab.diagnosis.verdict import BESIDE_CLAIMS, VERDICTS, ChannelVerdict, Claim
from tests.lab.diagnosis.test_live import model
from tests.lab.diagnosis.units import DPH, Bias, lagged, ramps, run, telegraph, three

TAU_S = 220.0


def lag(_: object, temperature: np.ndarray) -> np.ndarray:
    return np.asarray(-2.0 * (temperature - lagged(temperature, TAU_S)))


@pytest.fixture(scope="module")
def lagging() -> Diagnosis:
    return diagnose(*three(lag))


@pytest.fixture(scope="module")
def unexplained() -> Diagnosis:
    return diagnose(*three(telegraph))


def hidden(seed: int, size_dph: float, also: Bias) -> Bias:
    """Return an effect beside a load that nobody recorded: another course in each run."""

    def bias(time: np.ndarray, temperature: np.ndarray) -> np.ndarray:
        random = np.random.default_rng(seed)
        knots = np.arange(0.0, time[-1] + 900.0, 900.0)
        load = np.interp(time, knots, random.standard_normal(len(knots)))
        return np.asarray(also(time, temperature) + size_dph * load)

    return bias


def test_a_lag_of_the_training_is_not_named_where_the_test_is_driven_by_something_else() -> None:
    runs = [
        run(seed, *ramps(5000, up, 1.5), hidden(seed, size, lag))
        for seed, up, size in ((1, True, 0.0), (2, False, 0.0), (4, True, 40.0))
    ]
    found = diagnose(runs[:2], runs[2:])
    (verdict,) = found.verdicts
    assert verdict.test_before.rms > 8.0 * verdict.channel.floor.sd
    assert not verdict.claims
    assert verdict.unexplained
    assert "of the test" in verdict.remark
    assert report(found)["channels"]["gyro_x"]["ranking"][0]["name"] in ("thermal_lag", "dead_time")


def test_the_same_lag_is_named_where_the_test_shows_it(lagging: Diagnosis) -> None:
    (verdict,) = lagging.verdicts
    assert verdict.row.state == "named"
    assert verdict.test_before is not None
    assert verdict.test_after is not None
    assert verdict.test_after.rms < 0.5 * verdict.test_before.rms


def test_time_constant_and_coefficient_are_within_three_sigma(lagging: Diagnosis) -> None:
    (claim,) = lagging.verdicts[0].claims
    (sigma,), effect = claim.sigmas, claim.parts[0].effect
    off_s = effect.model_dump()["time_constant_s"] - TAU_S
    assert abs(off_s) < 3.0 * sigma.nonlinear["time_constant_s"]
    assert sigma.nonlinear["time_constant_s"] < 0.2 * TAU_S
    off = claim.parts[0].coefficients[0, 0] - -2.0 * DPH * effect.model_dump()["half_span"]
    assert abs(off) < 3.0 * sigma.coefficients[0, 0]


def test_the_page_leads_with_conclusion_proof_and_next_step(lagging: Diagnosis, tmp_path: Path) -> None:
    write_page(lagging, tmp_path / "report.html")
    text = (tmp_path / "report.html").read_text(encoding="utf-8")
    first = text[: text.index("<h2")]
    assert f"<h1>{conclusion(lagging)}</h1>" in first
    assert "→" in first
    assert next_step(lagging, tmp_path).why in first
    assert "±" in text


def test_where_nothing_is_named_ranking_runs_and_one_next_step_are_there(
    unexplained: Diagnosis, tmp_path: Path
) -> None:
    found = json.loads(json.dumps(report(unexplained, tmp_path)))
    channel = found["channels"]["gyro_x"]
    assert channel["verdict"] == "unexplained"
    assert len(channel["ranking"]) > 3
    assert [one["test"] for one in channel["runs"]] == [False, False, True]
    assert [bool(step["what"]) and bool(step["why"]) for step in found["next"]] == [True]
    assert unexplained.verdicts[0].in_short.startswith("unexplained")


@pytest.mark.parametrize(
    ("claims", "text"),
    [
        ((("thermal_lag", "dead_time"),), "thermal_lag or dead_time, not told apart"),
        (
            (("thermal_lag", "dead_time"), ("warm_up",)),
            "(thermal_lag or dead_time) and warm_up, not told apart",
        ),
        (
            (("thermal_lag", "dead_time"), ("dead_time",)),
            "(thermal_lag or another dead_time) and dead_time, not told apart",
        ),
        ((("step",), ("step",)), "step"),
    ],
)
def test_an_alternative_that_is_claimed_itself_is_another_one(
    lagging: Diagnosis, claims: tuple[tuple[str, ...], ...], text: str
) -> None:
    every = {one.family: one for one in lagging.verdicts[0].search.candidates}
    named = [
        Finding(every[one], alternatives={name: every[name] for name in others}) for one, *others in claims
    ]
    assert replace(lagging.verdicts[0], claims=[Claim(one, [], []) for one in named]).in_short == text


def walking(seed: int) -> Bias:
    """Return a random walk of 40 °/h in an hour."""

    def bias(time: np.ndarray, _: np.ndarray) -> np.ndarray:
        random = np.random.default_rng(seed)
        return np.asarray(40.0 / np.sqrt(3600.0) * np.cumsum(random.standard_normal(len(time))))

    return bias


def heavy_tails(diagnosis: Diagnosis) -> float:
    return float(report(diagnosis)["channels"]["gyro_x"]["slow_noise"]["heavy_tails"])


@pytest.mark.parametrize("unit", [1e3, 1e-6])
def test_sigmas_do_not_depend_on_the_unit(lagging: Diagnosis, unit: float) -> None:
    """Slopes in the unit of y were cut off beside the columns: 5e-18 s were the sigma of the lag."""
    train, test = three(lag)
    for one in (*train, *test):
        one.mean["gyro_x"] *= unit
        one.variance["gyro_x"] *= unit**2
    (claim,), (other,) = (one.verdicts[0].claims for one in (lagging, diagnose(train, test)))
    assert other.sigmas[0].nonlinear == pytest.approx(claim.sigmas[0].nonlinear, rel=1e-6)
    np.testing.assert_allclose(other.sigmas[0].coefficients, unit * claim.sigmas[0].coefficients, rtol=1e-6)


def test_what_is_unexplained_is_recorded_beside_what_may_drive_it_and_jumps_have_heavy_tails(
    unexplained: Diagnosis,
) -> None:
    runs = [run(seed, *ramps(5000, up), walking(seed)) for seed, up in ((11, True), (12, False), (13, True))]
    noisy = diagnose(runs[:2], runs[2:])
    assert [one.row.state for one in noisy.verdicts] == ["unexplained"]
    assert heavy_tails(unexplained) > PROVEN_GAIN > heavy_tails(noisy)
    for diagnosis in (unexplained, noisy):
        step = next_step(diagnosis, None)
        assert "supply" in step.what
        assert "imumon allan" in step.what
        assert "jumps or comes in bursts" in step.why


def test_a_test_that_is_off_by_a_constant_alone_needs_an_offset() -> None:
    levels = ((1, True, 0.0), (2, False, 0.0), (4, True, 4.0))
    runs = [run(seed, *ramps(5000, up, 1.5), lambda *at, a=a: lag(*at) + a) for seed, up, a in levels]
    found = diagnose(runs[:2], runs[2:])
    (verdict,) = found.verdicts
    assert [one.finding.name for one in verdict.claims] == ["thermal_lag"]
    assert verdict.unexplained
    assert next_step(found, None).what.startswith('Add " + offset" to --declared')
    beside = next_step(replace(found, model=model()), None)  # the command refuses both
    assert beside.what.startswith('Give --declared "polynomial N + offset" in place of --model')


def test_a_temperature_that_goes_one_way_only_is_reported_and_the_next_step_is_to_let_it_warm_and_cool(
    lagging: Diagnosis,
) -> None:
    """A late gyro that only warms after a cold start looks complete: its lag is part of the curve."""
    runs = list[Run]()
    for seed in (1, 2, 3):
        time = ramps(1200, up=True)[0]
        temperature = 24.0 + 14.0 * (1.0 - np.exp(-time / 700.0))
        runs.append(run(seed, time, temperature, lag))
    found = diagnose(runs[:2], runs[2:])
    assert "nothing" in conclusion(found)
    assert ONE_WAY in found.caveats
    assert "warms and cools" in next_step(found, None).what
    assert ONE_WAY not in lagging.caveats


def stepped(seed: int, step_degc: float) -> list[Run]:
    """Return three runs of steep straight curves, and nothing else, over a thermometer in steps."""
    found, slopes = list[Run](), {"gyro_x": 8.0, "gyro_y": -11.0}
    for at, up, rate in ((1, True, 1.5), (2, False, 1.5), (3, True, 1.0)):
        time, outside = ramps(2400, up, rate)
        temperature = lagged(outside, 90.0)
        one = run(10 * seed + at, time, temperature, lambda time, _: np.zeros_like(time), (*slopes,))
        for name, slope in slopes.items():
            one.mean[name] += slope * (temperature - 25.0) * DPH
        one.mean["temperature"] = np.round(one.mean["temperature"] / step_degc) * step_degc
        found.append(one)
    return found


@pytest.mark.long
def test_the_steps_of_a_thermometer_are_no_effect_where_that_takes_hardly_anything_away() -> None:
    *train, test = stepped(7, 1.0)
    found = diagnose(train, [test])
    assert [verdict.row.state for verdict in found.verdicts] == ["not proven", "not proven"]
    assert all("of all recordings: 1.2 white floors become 1.2" in one.remark for one in found.verdicts)


def test_without_a_test_the_next_step_is_one(lagging: Diagnosis, tmp_path: Path) -> None:
    assert "--test NEW" in next_step(replace(lagging, test=[]), tmp_path).command


def test_what_is_not_told_apart_is_one_verdict_with_one_next_step(lagging: Diagnosis, tmp_path: Path) -> None:
    (verdict,) = lagging.verdicts
    (claim,) = verdict.claims
    assert claim.finding.name == "thermal_lag"
    others = {"dead_time": claim.finding.candidate}
    both = claim._replace(finding=replace(claim.finding, alternatives=others))
    found = replace(lagging, verdicts=[replace(verdict, claims=[both])])
    assert found.verdicts[0].row.predicate == "claimed"
    assert conclusion(found) == "gyro_x: thermal_lag or dead_time, not told apart"
    assert "imumon plan" in next_step(found, tmp_path).command
    chosen = both._replace(finding=replace(both.finding, by_test=True))
    found = replace(lagging, verdicts=[replace(verdict, claims=[chosen])])
    assert "no independent proof" in conclusion(found)
    assert "--train TEST --test NEW" in next_step(found, tmp_path).command
    alone = claim._replace(finding=replace(claim.finding, alternatives={}))
    found = replace(lagging, verdicts=[replace(verdict, claims=[alone])])
    assert conclusion(found) == "gyro_x: thermal_lag"
    assert "model.yaml" in next_step(found, tmp_path).command


def test_the_documented_table_of_verdicts_is_the_one_that_is_evaluated() -> None:
    docs = Path(__file__).parents[3] / "docs"
    text = (docs / "appendix" / "closing-the-loop-details.md").read_text(encoding="utf-8")
    source = " ".join(inspect.getsource(ChannelVerdict).split())
    ends = [
        (row.predicate, f"{row.sentence.format(names='NAMES')} | `{row.state}` |")
        for row in VERDICTS
        if row.predicate
    ]
    ends += [(name, f'"{more}" |') for name, more in BESIDE_CLAIMS.items()]
    assert f"| otherwise | | {VERDICTS[-1].sentence} | `{VERDICTS[-1].state}` |" in text
    for name, end in ends:
        line = re.search(rf"^\| {name.replace('_', ' ')} \| (.+) \| {re.escape(end)}$", text, re.MULTILINE)
        assert line is not None, name
        meaning = line[1]
        assert f'"""{meaning[0].upper()}{meaning[1:]}' in source


def test_the_page_has_the_verdicts_in_the_order_in_which_they_are_evaluated() -> None:
    page = (Path(__file__).parents[3] / "docs" / "closing-the-loop.md").read_text(encoding="utf-8")
    shown = re.findall(r"^\| ([^|]+) \|", page.partition("| verdict | when |")[2], re.MULTILINE)
    sentences = [row.sentence.format(names="NAMES").partition(",")[0] for row in VERDICTS]
    assert shown[: len(VERDICTS)] == sentences
    added = re.findall(r"\*\*([^*]+)\*\*", page.partition("To the names may be added:")[2])
    assert added[:3] == [more.strip(", ").partition(",")[0] for more in BESIDE_CLAIMS.values()][:3]


def test_the_report_has_what_the_search_refused_and_why() -> None:
    train, test = three(lambda time, _: 2.5 * time / 2400.0)
    channel = report(diagnose(train, test))["channels"]["gyro_x"]
    assert channel["effects"] == []
    (refused,) = channel["refused"]
    assert (refused["stage"], refused["axes"]) == (1, ["gyro_x"])
    assert 0.0 < refused["gain_bic"] < 8.0
    assert refused["why"] == "the sum over the axes that show it is below the bar of 8.0"
