"""The pictures of the docs that are drawn, not taken of the live view."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import bias_race_study as race
import numpy as np
import random_error_study as wander
import sketches
from attitude_scenes import SCENES
from attitude_scenes import simulate as turned_unit
from attitude_table import heading_error, tilt_error
from closing_the_loop_measured import chamber_run
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from samples import crs05_model, play, sent, without
from smoothing_table import RATE_HZ as SMOOTHED_HZ
from smoothing_table import smoothed
from study import DOCS, ROOT, Cells, Options, Study, Table
from tczupt_study import LATITUDE_DEG, ZEROING
from tczupt_study import simulate as ramp_test
from thermometers import PER_HOUR

from imumon.blocks import FloatArray, IntArray
from imumon.estimation.attitude.stage import AttitudeEstimate
from imumon.estimation.gyro_bias.stage import RestAndBias, RestDetector
from imumon.estimation.rest.parameters import GyroBiasParameters
from imumon.estimation.temperature_rate.stage import MultipleModelRate, TemperatureRate
from imumon.geodesy import DEG_PER_H
from imumon.lab.diagnosis.diagnose import diagnose
from imumon.lab.diagnosis.runs import collect
from imumon.papers.fir import FirRate, Params
from imumon.simulation.unit import load_scenario

FOLDER = DOCS / "figures"
DEG = np.pi / 180.0


def axes(title: str, rows: int, x: str = "s") -> list[Axes]:
    """Return the axes of a new figure, one below the other."""
    figure = Figure(figsize=(8.0, 2.2 * rows + 1.0), dpi=80)
    drawn = [figure.add_subplot(rows, 1, row + 1) for row in range(rows)]
    figure.suptitle(title, fontsize=10)
    for ax in drawn:
        ax.set_xlabel(x)
        ax.grid(alpha=0.3)
    return drawn


def heated_unit() -> tuple[float, IntArray, FloatArray, FloatArray]:
    """Return step, times (ns), readings and true rate (°C/s) of a unit that heats itself from 34 to 67 °C."""
    step, t = 0.05, np.arange(3 * 3600 * 10) / 10.0
    temperature = 67.3 - 33.0 * np.exp(-t / 2700.0) + 0.25 * np.sin(2.0 * np.pi * t / 3600.0)
    noise = 0.002 * np.random.default_rng(1).standard_normal(len(t))
    reading = step * np.round((temperature + noise) / step)
    return step, np.rint(t * 1e9).astype(np.int64), reading, np.gradient(temperature, t)


def temperature_rate() -> list[Axes]:
    """Draw rates of a unit that heats itself, read in steps of 0.05 °C at 10 Hz."""
    difference_s = 180
    step, time_ns, reading, truth = heated_unit()
    t, segment = time_ns * 1e-9, np.zeros(len(time_ns), np.int64)
    width, difference = int(np.searchsorted(t, difference_s)), np.full(len(t), np.nan)
    difference[width:] = (reading[width:] - reading[:-width]) / difference_s
    fir, bank = FirRate(Params(step, 300.0, 180.0, 1000)), MultipleModelRate()
    above, middle, below = drawn = axes("A unit that heats itself, read in steps of 0.05 °C", 3, "min")
    shown = slice(int(np.searchsorted(t, 300.0)), None, 50)  # after five minutes every method has begun
    for name, rate, color in (("differences over 180 s", difference, "C0"), ("truth", truth, "k")):
        above.plot(t[shown] / 60.0, PER_HOUR * rate[shown], color, linewidth=0.9, label=name)
    above.set(ylabel="rate, °C/h")
    methods = (middle, "published filter", fir, "C1"), (below, "imumon", bank, "C2")
    for ax, name, method, color in methods:
        _, rate, _, rate_sd = method.process(time_ns, segment, reading)
        error, sd = (PER_HOUR * each[shown] for each in (rate - truth, rate_sd))
        ax.plot(t[shown] / 60.0, error, color, linewidth=0.9, label=f"{name}, ±2σ")
        ax.fill_between(t[shown] / 60.0, error - 2.0 * sd, error + 2.0 * sd, color=color, alpha=0.25)
        ax.set(ylim=(-4.0, 4.0), ylabel="error of the rate, °C/h")
    return drawn


def turn_or_bias() -> list[Axes]:
    """Draw a knock, a slow turn and a jump of the bias: what is called rest, and the bias meanwhile."""
    rate_hz, n = 100, 48_000
    rng, t = np.random.default_rng(9800), np.arange(n) / rate_hz
    gyro = 0.05 * DEG * rng.standard_normal((n, 3))
    accel = 0.01 * rng.standard_normal((n, 3)) + [0.0, 0.0, 9.80665]
    bias = np.where(t > 330.0, 0.35, 0.3)
    gyro[:, 2] += DEG * (bias + 0.5 * ((t > 150.0) & (t < 210.0)))
    knock = (t > 90.0) & (t < 91.0)
    gyro[knock] += 1.5 * DEG * rng.standard_normal((knock.sum(), 3))
    samples = sent(t, gyro=gyro, accel=accel)
    samples = samples.with_columns(RestAndBias().process(samples))
    rate, found, sd = (samples[name] / DEG for name in ("gyro_z", "gyro_bias_z", "gyro_bias_sd_z"))
    above, below = axes("A knock (90 s), a turn of 0.5 °/s (150 s), a jump of the bias by 180 °/h (330 s)", 2)
    above.plot(t[::rate_hz], rate.reshape(-1, rate_hz).mean(1), linewidth=0.9, label="gyro z, means of 1 s")
    above.fill_between(t, -0.2, 1.0, where=samples["at_rest"] == 1, alpha=0.2, color="C2", label="at rest")
    above.set(ylim=(-0.2, 1.0), ylabel="°/s")
    below.fill_between(t, found - 2.0 * sd, found + 2.0 * sd, alpha=0.3, label="bias ± 2σ")
    below.plot(t, found, linewidth=2.5, label="bias")
    below.plot(t, bias, "k--", linewidth=0.9, label="truth")
    below.set(ylim=(-0.2, 1.0), ylabel="bias of z, °/s")
    return [above, below]


def bias_in_motion() -> list[Axes]:
    """Draw the bias of y less the truth on a ramp of temperature without rest from 330 s on."""
    record = ramp_test("crs05-ramp", 0)
    block = record.block.with_columns({"at_rest": (record.seconds < 330.0).astype(np.int64)})
    above, ax = axes("A ramp of temperature; no rest is used after 330 s (grey: rest)", 2)
    part, given = slice(ZEROING, None, 50), GyroBiasParameters(assume_at_rest=True)
    above.plot(record.seconds[part], record.block["temperature"][part], "k", linewidth=0.9)
    above.set_ylabel("temperature, °C")
    for one in above, ax:
        one.axvspan(0.0, 330.0, color="0.85", zorder=0)
    for name, stage in {
        "held (standard)": RestAndBias(given, latitude_deg=LATITUDE_DEG, heading_deg=0.0),
        "thermal": RestAndBias(given, crs05_model(), "thermal", LATITUDE_DEG, 0.0),
    }.items():
        added = stage.process(block)
        error = ((added["gyro_bias_y"] - record.bias[:, 1]) / DEG_PER_H)[part]
        sd = (added["gyro_bias_sd_y"] / DEG_PER_H)[part]
        ax.plot(record.seconds[part], error, linewidth=1.0, label=name)
        ax.fill_between(record.seconds[part], error - 2.0 * sd, error + 2.0 * sd, alpha=0.2)
    ax.set_ylabel("error of the bias of y, ±2σ, °/h")
    return [above, ax]


def smoothed_bias() -> list[Axes]:
    """Draw the error of the bias of a unit that is handled, with rests of 10 s, live and smoothed."""
    record, _, columns = smoothed("warm-up", 900, 100)
    above, below = drawn = axes("Turned by hand, at rest for 10 s every two minutes (grey): bias of y", 2)
    t, part = record.stop / SMOOTHED_HZ, slice(None, None, 8)
    for label, name, of in ("live", "gyro_bias", record.columns), ("smoothed", "gyro_bias_smoothed", columns):
        error = (of[f"{name}_y"] - columns["true"][:, 1]) / DEG_PER_H
        above.plot(t[part], error[part], linewidth=1.0, label=label)
        below.plot(t[part], (of[f"{name}_sd_y"] / DEG_PER_H)[part], linewidth=1.0, label=label)
    above.set(ylabel="error, °/h", xlim=(0.0, 480.0), ylim=(-100.0, 400.0))
    below.set(ylabel="σ, °/h", xlim=(0.0, 480.0), ylim=(0.0, 400.0))
    for ax in drawn:
        ax.fill_between(t, *ax.get_ylim(), where=columns["at_rest"] == 1, color="0.85", zorder=0)
    return drawn


def bias_race() -> list[Axes]:
    """Draw the error of the bias of y in the race, by four methods, on the first half of a warm-up."""
    run = play(race.scenario_of(race.WARM_UP), 0, (TemperatureRate(), RestDetector()), 90_000)
    (ax,) = axes("Carried about, at rest for 10 s every two minutes (grey)", 1)
    t, truth = run.time_s - run.time_s[0], (run.bias + run.earth)[:, 1]
    tuned = {"restThGyr": 0.3, "restMinT": 1.5, "biasForgettingTime": 100.0, "biasSigmaRest": 0.01}
    for name, method in {
        "mean of each rest, held": race.averaging,
        "VQF, tuned": race.vqf(**tuned, motionBiasEstEnabled=True),
        "imumon learned": race.imumon("learned", None, True),
        "imumon thermal": race.imumon("thermal", race.calibrated(), True),
    }.items():
        ax.plot(t[::20], ((method(run)[:, 1] - truth) / DEG_PER_H)[::20], linewidth=1.0, label=name)
    ax.fill_between(t, -60.0, 180.0, where=run.rest, color="0.85", zorder=0)
    ax.set(ylabel="error of the bias of y, °/h", xlim=(0.0, 900.0), ylim=(-60.0, 180.0))
    return [ax]


def attitude_sigma() -> list[Axes]:
    """Draw error of tilt and heading beside sigma of a unit that is turned by hand without a magnetometer."""
    record = turned_unit(SCENES["by hand"], 50.0, 9700)
    samples = without(record.samples, "mag")
    for stage in (RestAndBias(mode="learned"), AttitudeEstimate()):
        samples = samples.with_columns(stage.process(samples))
    known = int(np.argmax(np.isfinite(samples["attitude_estimate_tilt_sd"]))) + 1
    samples, truth = samples.rows(known, len(samples)), record.attitude[known:]
    q = np.column_stack([samples[f"attitude_estimate_{part}"] for part in "wxyz"])
    heading_sd = samples["attitude_estimate_heading_sd"]
    turn = np.abs(heading_error(q, truth, int(np.argmax(np.isfinite(heading_sd))), True))
    tilt, tilt_sd = np.linalg.norm(tilt_error(q, truth), axis=1), samples["attitude_estimate_tilt_sd"]
    t = samples["device_time_ns"] * 1e-9
    upper, lower = axes("Turned by hand for 30 s, at rest for 10 s, and so on; no magnetometer", 2)
    total = np.sqrt(2.0) * tilt_sd
    for ax, name, error, sd in (upper, "tilt", tilt, total), (lower, "relative heading", turn, heading_sd):
        ax.fill_between(t, np.degrees(sd), alpha=0.3, label="sigma")
        z = error / sd
        label = f"error: {np.sqrt(np.nanmean(z**2)):.1f} σ rms, {np.nanmax(z):.1f} σ at most"
        ax.plot(t, np.degrees(error), linewidth=0.8, label=label)
        ax.set_ylabel(f"{name}, °")
    upper.set_ylim(0.0, 5.0)  # the first sigma would flatten all that follows
    first = f"gyros not confirmed yet: sigma up to {np.degrees(np.nanmax(total)):.0f}°"
    upper.annotate(first, (23.8, 4.5), (29.0, 4.35), arrowprops={"arrowstyle": "->"}, fontsize=8)
    steep = np.hypot(truth[:, 2, 1], truth[:, 2, 2]) < np.sin(15.0 * DEG)
    lower.fill_between(t, 1.0, where=steep, transform=lower.get_xaxis_transform(), color="0.9", zorder=0)
    lower.set_ylim(0.0, 15.0)
    return [upper, lower]


def steps() -> list[Axes]:
    """Draw the worked case of docs/closing-the-loop.md, gyros that are 30 s late: training, lag, test."""
    plan = load_scenario("crs05-ramp-lag").played(10.0, "FRD")
    first, second, third = (
        collect([play(plan, seed, (RestDetector(),)).samples], f"S{seed}")[0] for seed in (1, 2, 3)
    )
    found = diagnose([first, second], [third], "polynomial 5 + offset", sensors=("gyro",))
    verdict = next(one for one in found.verdicts if one.name == "gyro_y")
    figure = Figure(figsize=(11.0, 3.3), dpi=80)
    loop, effect, test = figure.subplots(1, 3, sharey=True)
    residuals = [fit.residual / DEG_PER_H for fit in (verdict.before, verdict.after)]
    at = 0
    for run in verdict.channel.training.runs:
        minutes, rows = run.time_s / 60.0, slice(at, at + len(run))
        before, after = (residual[rows] for residual in residuals)
        degc = verdict.channel.temperature[rows]
        loop.plot(degc, before, ".-", ms=4, lw=0.4, label=run.in_slots.name)
        effect.plot(minutes, before, ".", ms=4)
        effect.plot(minutes, before - after, "k-", lw=1.2, label="" if at else "fitted lag")
        at += len(run)
    (last,) = verdict.channel.test
    scores = {"curve alone": (verdict.test_before, "C3."), "curve and lag": (verdict.test_after, "C2.")}
    for label, (score, style) in scores.items():
        name = f"{label}: {score.rms / DEG_PER_H:.2g} °/h rms"
        test.plot(last.time_s / 60.0, score.predicted_residual[0] / DEG_PER_H, style, ms=4, label=name)
    floor = verdict.channel.floor.sd / DEG_PER_H
    titles = ("1: error of the best curve", "2: the same over time", "3: unused recording S3")
    for one, title in zip((loop, effect, test), titles, strict=True):
        one.axhspan(-floor, floor, color="0.85", zorder=0, label="white noise, ±1σ")
        one.set(title=title, xlabel="minutes since power-on")
        one.grid(alpha=0.3)
    loop.set(xlabel="temperature, °C", ylabel="error of gyro_y, °/h")
    return [loop, effect, test]


def random_error() -> list[Axes]:
    """Draw an hour at rest: the drift of the bias, the default estimate, and the first minute held."""
    record = wander.simulate(wander.HOUR, wander.HOUR_SEEDS[0])
    above, below = drawn = axes("One hour at rest at constant temperature", 2, "min")
    rest, shown = np.ones(len(record.drift)), slice(60 * wander.RATE_HZ, None, 5 * wander.RATE_HZ)
    minutes = np.arange(len(rest))[shown] / (60.0 * wander.RATE_HZ)
    true = wander.HOUR * record.drift[shown]
    above.plot(minutes, true, "0.6", lw=0.9, label="true bias")
    for name, label in {"drift": "default", "hold 60 s": "mean of the first minute, held"}.items():
        values, _, sd = (wander.HOUR * one[shown] for one in wander.slow(name, rest, record))
        above.plot(minutes, values, linewidth=1.5, label=label)
        if name == "drift":
            below.fill_between(minutes, -2.0 * sd, 2.0 * sd, alpha=0.2, label="±2σ of the default")
            below.plot(minutes, values - true, linewidth=0.9, label="error of the default")
    above.set(ylabel="bias, °/h", ylim=(-100.0, 150.0))
    below.set(ylabel="error of the bias, °/h", ylim=(-150.0, 150.0))
    return drawn


def chamber_cycle() -> list[Axes]:
    """Draw what a cubic leaves of each gyro of the measured record, and what is left with the effects."""
    folder = Path(os.environ.get("IMUMON_DATA", ROOT.parent / "shared" / "data"))
    found = diagnose([chamber_run(folder / "chamber-cycle")], (), "polynomial 3", sensors=("gyro",))
    figure = Figure(figsize=(11.0, 3.3), dpi=80)
    drawn = list(figure.subplots(1, 3))
    for one, verdict in zip(drawn, found.verdicts, strict=True):
        (run,) = verdict.channel.training.runs
        effects = ", ".join(claim.finding.name for claim in verdict.claims) or "nothing named"
        minutes, before, after = run.time_s / 60.0, verdict.before.residual, verdict.after.residual
        one.plot(minutes, np.degrees(before), "C3o", ms=7, mfc="none", label="cubic")
        one.plot(minutes, np.degrees(after), "C2.", ms=4, label=f"with {effects}")
        one.set_title(verdict.name, fontsize=10)
        one.set_xlabel("minutes since the start")
        one.grid(alpha=0.3)
    drawn[0].set_ylabel("residual, °/s")
    return drawn


_OWN = attitude_sigma, turn_or_bias, bias_in_motion, bias_race, smoothed_bias, temperature_rate, random_error
PICTURES: dict[str, Callable[[], list[Axes]]] = {
    **{drawing.__name__.replace("_", "-"): drawing for drawing in _OWN},
    "closing-the-loop/steps": steps,
    "closing-the-loop/chamber-cycle": chamber_cycle,
    "glossary/allan": sketches.allan_curve,
    "glossary/axes": sketches.body_axes,
    "glossary/bias-over-temperature": sketches.biases_over_temperature,
}


def tables(given: Options) -> Iterator[Table]:
    """Draw the pictures into docs/figures; yield their names and sizes."""
    chosen = [name for name in PICTURES if given.only in name][: 1 if given.quick else None]
    rows: list[Cells] = []
    for name in chosen:
        drawn = PICTURES[name]()
        for ax in drawn:
            if ax.get_legend_handles_labels()[0]:
                ax.legend(fontsize=8)
        figure = drawn[0].figure
        assert isinstance(figure, Figure)
        figure.tight_layout()
        path = FOLDER / f"{name}.png"
        path.parent.mkdir(exist_ok=True)
        figure.savefig(path, metadata={"Software": None})
        rows.append([path.relative_to(DOCS).as_posix(), path.stat().st_size / 1000.0])
    yield Table("", ["picture", "kB"], rows, formats=("", ".0f"))


STUDY = Study(tables)
