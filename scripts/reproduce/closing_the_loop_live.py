"""Does the live search name what a calibration had inside, and nothing where nothing is missing?

A curve is fitted to two runs of a unit whose bias has an undeclared effect, so that the model's `residual_sd`
covers it; a third run from another power-on goes sample by sample through the stage that says MODEL CAN BE
BETTER.

Usage: closing_the_loop --part live [--repeat N] [--first SEED] [--only KIND] [--least FLOORS] [--jobs N]
       [--results FILE] [--out PAGE]
"""

from __future__ import annotations

import argparse
import json
import os
import re
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict, dataclass, replace
from pathlib import Path

for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import closing_the_loop_drivers as drivers  # noqa: E402
import numpy as np  # noqa: E402 - the number of threads is read when it is imported
from closing_the_loop_cases import DPH, EARTH_DPH, GRAVITY, Case, Setting, make_case  # noqa: E402
from closing_the_loop_statistics import share  # noqa: E402
from numpy.polynomial.chebyshev import chebvander  # noqa: E402

from imumon.blocks import ColumnArray, SampleBlock  # noqa: E402
from imumon.lab.diagnosis.blocks import make_blocks  # noqa: E402
from imumon.lab.diagnosis.channel import ordinary  # noqa: E402
from imumon.lab.diagnosis.live import LiveDiagnosis  # noqa: E402
from imumon.lab.diagnosis.runs import Run  # noqa: E402
from imumon.models.curves.polynomial import PolynomialCurve  # noqa: E402
from imumon.models.model import BiasModel, ChannelModel  # noqa: E402

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
HEAD = (
    "# Closing the loop: live sessions\n\n"
    "Made by `scripts/reproduce/closing_the_loop_live.py`. Right is what is named last when the effect"
    " is among the three best on every axis that is named; `named` counts sessions in which anything was"
    " named by any search. Wilson's 95 % interval.\n\n"
)
SAID = re.compile(r"MODEL CAN BE BETTER: (.*?): ([\d.e+-]+) become ([\d.e+-]+) °/h")


@dataclass(frozen=True, slots=True)
class Said:
    """What was said of a session, last: the effects, the axes, when first, and what it cost."""

    label: str
    size: float
    seed: int
    truth: tuple[str, ...]
    said: tuple[tuple[tuple[str, ...], str], ...]
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
    found += [
        Setting((), size, driver=name, label=f"driven: {name}") for name in drivers.DRIVING for size in SIZES
    ]
    found += [
        Setting((), 0.0, noise=noise, label=f"nothing, {noise}") for noise in ("white", "flicker", "walk")
    ]
    found += [
        Setting((), 0.0, noise=noise, label=f"nothing, constant, {noise}")
        for noise in ("white", "flicker", "walk")
    ]
    found += [
        Setting((), 0.0, noise=noise, poses=True, label=f"nothing, poses, {noise}")
        for noise in ("white", "flicker", "walk")
    ]
    found += [
        Setting(
            (), 0.0, noise=noise, poses=True, latitude_deg=50.0, label=f"nothing, poses, earth rate, {noise}"
        )
        for noise in ("white", "flicker", "walk")
    ]
    found += [
        Setting(("g_sensitivity",), size, poses=True, latitude_deg=50.0, label="g_sensitivity, earth rate")
        for size in (10.0, 50.0)
    ]
    found += [
        Setting((), 0.0, noise=noise, driver="none", label=f"nothing, ten columns, {noise}")
        for noise in ("white", "flicker", "walk")
    ]
    found += [
        Setting((), 0.0, noise=noise, label=f"nothing, {BEYOND}, {noise}") for noise in ("white", "flicker")
    ]
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
        found = ordinary(columns[known], values[known])
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


def held(run: Run, seed: int) -> Run:
    """Return a run as it would be had its temperature stayed where it began: its noise alone."""
    rng = np.random.default_rng([seed, 5])
    t = 25.0 + 0.2 * np.sin(2 * np.pi * run.time_s / 3000.0) + 0.01 * rng.standard_normal(len(run.time_s))
    return replace(run, mean={**run.mean, "temperature": np.round(t * 16) / 16})


def level_earth_rate(run: Run, latitude_deg: float, seed: int) -> Run:
    """Return a run with the horizontal earth rate, too, another heading in each pose."""
    rng = np.random.default_rng([seed, 6])
    up = np.column_stack([run.mean[f"accel_{axis}"] for axis in AXES]) / GRAVITY
    turns = np.flatnonzero(np.abs(np.diff(up, axis=0)).max(axis=1) > 0.5) + 1
    changed = dict(run.mean)
    for rows in np.split(np.arange(len(up)), turns):
        across = np.cross(up[rows[0]].round(), rng.normal(size=3))
        level = EARTH_DPH * np.cos(np.radians(latitude_deg)) * DPH * across / np.linalg.norm(across)
        for at, axis in enumerate(AXES):
            changed[f"gyro_{axis}"] = changed[f"gyro_{axis}"].copy()
            changed[f"gyro_{axis}"][rows] += level[at]
    return replace(run, mean=changed)


def blocks_of(run: Run) -> list[SampleBlock]:
    """Return a run as blocks of a sample a second."""
    n = len(run.time_s)
    columns: dict[str, ColumnArray] = {
        "device_time_ns": np.round(run.time_s * 1e9).astype(np.int64),
        "segment": np.zeros(n, np.int64),
        "at_rest": np.rint(run.rest).astype(np.int64),
        **{name: np.asarray(values) for name, values in run.mean.items()},
    }
    return [
        SampleBlock({name: values[at : at + PIECE] for name, values in columns.items()})
        for at in range(0, n, PIECE)
    ]


def run_case(job: tuple[Setting, int]) -> Said:
    """Return what is said of the third run of a case."""
    setting, seed = job
    case = drivers.make(setting, seed) if setting.driver else make_case(setting, seed)
    if setting.latitude_deg is not None:
        case = replace(case, runs=[level_earth_rate(run, setting.latitude_deg, seed) for run in case.runs])
    model, last = plain_model(case), case.runs[2]
    if "constant" in setting.label:
        temperature = case.runs[2].mean["temperature"]
        last = held(last, seed)
        change = {
            name: last.mean[name]
            - channel.value(temperature)
            + channel.value(np.full(len(temperature), 25.0))
            for name, channel in model.channels.items()
        }
        last = replace(last, mean={**last.mean, **change})
    stage, spent, since, texts = LiveDiagnosis(model), 0.0, np.nan, list[str]()
    for block in blocks_of(last):
        began = time.process_time()
        stage.process(block)
        spent += time.process_time() - began
        for text in stage.notices():
            since = since if np.isfinite(since) else float(block["device_time_ns"][-1]) * 1e-9
            texts.append(text)
    state = SAID.search(stage.state)
    said = tuple(_groups(state.group(1))) if state else ()
    numbers = (float(state.group(2)), float(state.group(3))) if state else (np.nan, np.nan)
    truth = tuple(sorted(set().union(*case.truth)))
    return Said(setting.label, setting.size, seed, truth, said, since, *numbers, spent, " | ".join(texts))


def _groups(text: str) -> list[tuple[tuple[str, ...], str]]:
    """Return effects and axes of what was said."""
    found = []
    for part in re.split(r"; ", text):
        what, _, axes = part.rpartition(" on ")
        found.append((tuple(what.split(" or ")), axes))
    return found


def right(one: Said) -> bool:
    """Tell whether the effect is named, alone or in a set of at most three, on any axis and none but it."""
    return bool(one.said) and all(set(names) & set(one.truth) for names, _ in one.said)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the sessions and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeat", type=int, default=4)
    parser.add_argument("--first", type=int, default=2500)
    parser.add_argument("--only", default="")
    parser.add_argument("--least", type=float, default=0.0, help="size in floors of the smallest effect")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--list", action="store_true")
    parser.add_argument("--results", type=Path, help="file of sessions that are done, which grows by these")
    parser.add_argument("--out", type=Path, help="page to write the table to")
    given = parser.parse_args(arguments)
    work = [
        (setting, 1000 * at + given.first + number)
        for at, setting in enumerate(settings())
        if given.only in setting.label and setting.size >= given.least
        for number in range(given.repeat * (5 if setting.label.startswith("nothing") else 1))
    ]
    results = kept(given.results)
    done = {(one.label, one.size, one.seed) for one in results}
    work = [job for job in work if (job[0].label, job[0].size, job[1]) not in done]
    with ProcessPoolExecutor(given.jobs) as pool:
        for one in pool.map(run_case, work):
            results.append(one)
            if given.results is not None:
                with given.results.open("a", encoding="utf-8") as file:
                    file.write(json.dumps(asdict(one)) + "\n")
    if given.list:
        for one in results:
            mark = "" if right(one) or not one.truth else "BAD "
            print(f"{mark}{one.label} {one.size:g} #{one.seed} {one.since_s:.0f} s: {one.text}")
    text = table(results)
    print(text)
    if given.out is not None:
        given.out.write_text(HEAD + text + "\n", encoding="utf-8")
    return 0


def kept(path: Path | None) -> list[Said]:
    """Return the sessions that earlier runs left in a file."""
    if path is None or not path.exists():
        return []
    found = []
    for line in path.read_text(encoding="utf-8").splitlines():
        one = json.loads(line)
        said = tuple((tuple(names), axes) for names, axes in one["said"])
        found.append(Said(**(one | {"truth": tuple(one["truth"]), "said": said})))
    return found


def table(results: Sequence[Said]) -> str:
    """Return what was said, as Markdown."""
    lines = [
        "| effect | floors | named | right | first named, min, median | °/h before | after |",
        "|---|---|---|---|---|---|---|",
    ]
    labels = list(dict.fromkeys(one.label for one in results))
    kinds = {(one.label, one.size) for one in results}
    for label, size in sorted(kinds, key=lambda kind: (labels.index(kind[0]), kind[1])):
        found = [one for one in results if (one.label, one.size) == (label, size)]
        said = [one for one in found if one.said]
        ever = sum(bool(one.text) for one in found)
        good = share(sum(map(right, found)), len(found)) if found[0].truth else ""
        when = f"{np.median([one.since_s for one in said]) / 60:.0f}" if said else ""
        numbers = [
            f"{np.median([getattr(one, key) for one in said]):.3g}" if said else ""
            for key in ("before", "after")
        ]
        lines.append(
            f"| {label} | {size:g} | {share(ever, len(found))} | {good} | {when} | {' | '.join(numbers)} |"
        )
    seconds = [one.seconds for one in results]
    lines += [
        "",
        f"{np.median(seconds):.2f} s of a core for two hours (median; the longest {max(seconds):.2f} s).",
    ]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
