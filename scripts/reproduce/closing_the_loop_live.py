"""Does the live search name what a calibration had inside, and nothing where nothing is missing?

A curve is fitted to two runs of a unit whose bias has an undeclared effect, so that the model's `residual_sd`
covers it; a third run from another power-on goes sample by sample through the stage that reports MODEL CAN BE
BETTER.
"""

import re
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import groupby
from typing import Any

import numpy as np
from closing_the_loop_cases import Case, Setting, make_case
from closing_the_loop_physics import DRIVING
from closing_the_loop_statistics import share
from numpy.polynomial.chebyshev import chebvander
from samples import sent
from study import Options, Study, Table, spread

from imumon.blocks import SampleBlock
from imumon.lab.diagnosis.blocks import make_blocks
from imumon.lab.diagnosis.candidates import least_squares
from imumon.lab.diagnosis.live import LiveDiagnosis
from imumon.lab.diagnosis.runs import Run
from imumon.models.curves.polynomial import PolynomialCurve
from imumon.models.model import BiasModel, ChannelModel

AXES = "xyz"
DEGREE = 3
PIECE = 10
"""Samples, one a second, in a block."""
EFFECTS = (
    "temperature_curve",
    "temperature_rate",
    "thermal_lag",
    "dead_time",
    "hysteresis",
    "warm_up",
    "stress_relaxation",
    "drift",
    "periodic",
    "g_sensitivity",
)
SIZES = (1.0, 2.0, 5.0, 10.0)
BEYOND = "beyond the calibration"
"""Label of the sessions that leave the middle half of the temperatures, which the calibration is cut to."""
NOISES = ("white", "flicker", "walk")
POSES: Mapping[str, Any] = {"poses": True, "latitude_deg": 50.0}
NOTHING: Mapping[str, tuple[Sequence[str], Mapping[str, Any]]] = {
    "nothing": (NOISES, {}),
    "nothing, constant": (NOISES, {}),
    "nothing, poses": (NOISES, {"poses": True}),
    "nothing, poses, earth rate": (NOISES, POSES),
    "nothing, ten columns": (NOISES, {"driver": "none"}),
    f"nothing, {BEYOND}": (NOISES[:2], {}),
}
"""Sessions of which nothing is missing: noises, and what else a setting has."""
QUICK = "nothing, white"
HEADS = ("effect", "floors", "named", "right", "first named, min, median", "°/h before", "after")
REPORT = re.compile(r"MODEL CAN BE BETTER: (.*?): ([\d.e+-]+) become ([\d.e+-]+) °/h")


@dataclass(frozen=True, slots=True)
class Session:
    """The last report of a session: the effects, the axes, when first, and what it cost."""

    label: str
    size: float
    seed: int
    truth: tuple[str, ...]
    named: tuple[tuple[tuple[str, ...], str], ...]
    since_s: float
    before: float
    after: float
    seconds: float
    text: str


def settings() -> list[Setting]:
    """Return the kinds of sessions."""
    found = [
        Setting((name,), size, poses=name == "g_sensitivity", label=name)
        for name in EFFECTS
        for size in SIZES
    ]
    found += [Setting((), size, driver=name, label=f"driven: {name}") for name in DRIVING for size in SIZES]
    for label, (noises, more) in NOTHING.items():
        found += [Setting((), 0.0, noise=noise, label=f"{label}, {noise}", **more) for noise in noises]
        if more == POSES:
            beside = "g_sensitivity, earth rate"
            found += [Setting(("g_sensitivity",), size, label=beside, **POSES) for size in (10.0, 50.0)]
    found += [Setting((), 0.0, turn_on_dph=8.0, label="nothing, turn-on offsets")]
    return found


def plain_model(case: Case) -> BiasModel:
    """Return a curve alone, fitted to two runs with a constant of each pose, and what it leaves of them."""
    runs = [make_blocks(run, [f"gyro_{axis}" for axis in AXES], ["temperature"]) for run in case.runs[:2]]
    t = np.concatenate([run.temperature["temperature"] for run in runs])
    low, high = np.quantile(t, [0.25, 0.75] if BEYOND in case.setting.label else [0.0, 1.0]).tolist()
    known = (t >= low) & (t <= high)
    u = (2.0 * t - low - high) / (high - low)
    pose = np.concatenate([1000 * at + run.pose for at, run in enumerate(runs)])
    levels = np.asarray(pose[:, np.newaxis] == np.unique(pose[known]), np.float64)
    channels = {}
    for axis in AXES:
        values = np.concatenate([run.mean[f"gyro_{axis}"] for run in runs])
        columns = np.column_stack([levels, chebvander(u, DEGREE)[:, 1:]])
        found = least_squares(columns[known], values[known])
        left = (values - columns @ found)[known]
        channels[f"gyro_{axis}"] = ChannelModel(
            unit="rad/s",
            temperature_column="temperature",
            temperature_range_degc=[low, high],
            residual_sd=float(left.std()),
            curve=PolynomialCurve(
                center_degc=0.5 * (low + high),
                half_width_degc=0.5 * (high - low),
                coefficients=[float(found[: levels.shape[1]].mean()), *found[levels.shape[1] :].tolist()],
            ),
        )
    return BiasModel(made_by="closing_the_loop", created="2026-01-01T00:00:00Z", channels=channels)


def held(run: Run, model: BiasModel, seed: int) -> Run:
    """Return a run as it would be had its temperature stayed at 25 °C: without the curve of the model."""
    rng, n = np.random.default_rng([seed, 5]), len(run.time_s)
    t = 25.0 + 0.2 * np.sin(2 * np.pi * run.time_s / 3000.0) + 0.01 * rng.standard_normal(n)
    mean = {**run.mean, "temperature": np.round(t * 16) / 16}
    for name, channel in model.channels.items():
        mean[name] = mean[name] - channel.value(run.mean["temperature"]) + channel.value(np.full(n, 25.0))
    return replace(run, mean=mean)


def blocks_of(run: Run) -> list[SampleBlock]:
    """Return a run as blocks of a sample a second."""
    samples = sent(run.time_s, at_rest=np.rint(run.rest), **run.mean)
    return [samples.rows(at, at + PIECE) for at in range(0, len(samples), PIECE)]


def run_case(job: tuple[Setting, int]) -> Session:
    """Return what is reported of the third run of a case."""
    setting, seed = job
    case = make_case(setting, seed)
    model, last = plain_model(case), case.runs[2]
    if "constant" in setting.label:
        last = held(last, model, seed)
    stage, spent, since, texts = LiveDiagnosis(model), 0.0, np.nan, list[str]()
    for block in blocks_of(last):
        began = time.process_time()
        stage.process(block)
        spent += time.process_time() - began
        for text in stage.notices():
            since = since if np.isfinite(since) else float(block["device_time_ns"][-1]) * 1e-9
            texts.append(text)
    state = REPORT.search(stage.state)
    named = tuple(_groups(state.group(1))) if state else ()
    numbers = (float(state.group(2)), float(state.group(3))) if state else (np.nan, np.nan)
    truth = tuple(sorted(set().union(*case.truth)))
    return Session(setting.label, setting.size, seed, truth, named, since, *numbers, spent, " | ".join(texts))


def _groups(text: str) -> list[tuple[tuple[str, ...], str]]:
    """Return effects and axes of a report."""
    found = []
    for part in re.split(r"; ", text):
        what, _, axes = part.rpartition(" on ")
        found.append((tuple(what.split(" or ")), axes))
    return found


def right(one: Session) -> bool:
    """Return whether the effect is named, alone or in a set of at most three, on any axis and none but it."""
    return bool(one.named) and all(set(names) & set(one.truth) for names, _ in one.named)


def row(found: Sequence[Session]) -> list[str]:
    """Return the row of one kind of sessions."""
    first, sessions = found[0], [one for one in found if one.named]
    cells = [first.label, f"{first.size:g}", share(sum(bool(one.text) for one in found), len(found))]
    cells.append(share(sum(map(right, found)), len(found)) if first.truth else "")
    if not sessions:
        return [*cells, "", "", ""]
    since, before, after = np.median([(one.since_s / 60, one.before, one.after) for one in sessions], axis=0)
    return [*cells, f"{since:.0f}", f"{before:.3g}", f"{after:.3g}"]


def tables(given: Options) -> Iterator[Table]:
    """Yield the sessions by kind and size; five times as many of those with nothing missing."""
    only = QUICK if given.quick else given.only
    work = [
        (setting, 1000 * at + given.seeds[0] + number)
        for at, setting in enumerate(settings())
        if only in setting.label
        for number in range(len(given.seeds) * (5 if setting.label.startswith("nothing") else 1))
    ]
    results = list(spread(run_case, work[: 1 if given.quick else None], given.jobs))
    groups = groupby(results, key=lambda one: (one.label, one.size))
    seconds = [one.seconds for one in results]
    note = f"{np.median(seconds):.2f} s of a core for two hours (median; the longest {max(seconds):.2f} s)."
    yield Table("", HEADS, [row(list(found)) for _, found in groups], note)


STUDY = Study(tables, seeds=4, first=2500, page="appendix/closing-the-loop-live.md")
