"""What one session can tell at all of an effect whose course is known but for its size.

Of the sessions of `closing_the_loop_live.py`: the gain in BIC of the true course over noise alone, each with
the white, flicker and random-walk noise that suits it best, and with the noise known.  Of a sensitivity to g:
by how much the pose constants of three gyros differ from anything that the earth rate can make of them in a
unit laid by nobody knows which heading, less what the eight numbers cost that are more.

Usage: closing_the_loop --part limits [--repeat N] [--first SEED]
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence
from dataclasses import replace

import closing_the_loop_drivers as drivers
import numpy as np
from closing_the_loop_cases import DPH, EARTH_DPH, GRAVITY, Case, Setting, make_case
from closing_the_loop_live import AXES, level_earth_rate, plain_model, settings
from scipy.optimize import least_squares

from imumon.blocks import FloatArray
from imumon.lab.diagnosis.better import residual
from imumon.lab.diagnosis.blocks import RunBlocks, make_blocks
from imumon.lab.diagnosis.likelihood import Likelihood
from imumon.lab.diagnosis.runs import Run

NAMES = [f"gyro_{axis}" for axis in AXES]
KNOWN = (0.3, 0.0)
"""The noise of the grid that is nearest to theirs: flicker of 1 beside white noise of 1.6 °/h."""
EARTHS = 10
"""Numbers that the earth rate leaves open: three constants, the latitude, and six headings."""
STARTS = 40
"""Latitudes from which it is looked for, with the headings that the gyros then show."""


def case_of(setting: Setting, seed: int) -> Case:
    """Return a case of the live sessions."""
    case = drivers.make(setting, seed) if setting.driver else make_case(setting, seed)
    if setting.latitude_deg is None:
        return case
    return replace(case, runs=[level_earth_rate(run, setting.latitude_deg, seed) for run in case.runs])


def told(setting: Setting, seed: int) -> list[tuple[float, float]]:
    """Return, of each gyro, the gain of the true course in BIC, with the noise unknown and known."""
    case, bare = case_of(setting, seed), case_of(replace(setting, size=0.0), seed)
    run = residual(case.runs[2], plain_model(case), NAMES)
    true = make_blocks(_less(case.runs[2], bare.runs[2]), NAMES, ["temperature"])
    likelihood, t = Likelihood([run]), run.temperature["temperature"]
    u, one = (t - t.mean()) / np.ptp(t), np.ones((len(t), 1))
    found = []
    for name in NAMES:
        values, gains = run.mean[name], []
        nothing = likelihood.best(values, one)[0], likelihood.at(values, one, KNOWN)
        for degree in (0, 3):
            columns = np.column_stack([u[:, np.newaxis] ** np.arange(degree + 1), true.mean[name]])
            price = (degree + 1) * likelihood.price
            best = likelihood.best(values, columns)[0], likelihood.at(values, columns, KNOWN)
            gains.append(
                [2.0 * (with_it - bare) - price for with_it, bare in zip(best, nothing, strict=True)]
            )
        unknown, known = np.max(gains, axis=0).tolist()
        found.append((unknown, known))
    return found


def _less(run: Run, bare: Run) -> Run:
    return replace(run, mean={**run.mean, **{name: run.mean[name] - bare.mean[name] for name in NAMES}})


def beyond_earth(setting: Setting, seed: int) -> float:
    """Return by how much six poses differ from what the earth rate can make, in BIC."""
    case = case_of(setting, seed)
    run = residual(case.runs[2], plain_model(case), NAMES)
    likelihood = Likelihood([run])
    which = np.asarray(run.pose[:, np.newaxis] == np.unique(run.pose), np.float64)
    force = np.column_stack([case.runs[2].mean[f"accel_{axis}"] for axis in AXES])
    up = np.round(np.array([force[_seconds(run, column)].mean(axis=0) for column in which.T]) / GRAVITY)
    levels, roots = [], []
    for name in NAMES:
        values = run.mean[name]
        noise = likelihood.best(values, which)[1]
        white = likelihood.white(np.column_stack([which, values]), noise)
        root = np.linalg.qr(white[:, :-1])[1]
        level = np.linalg.lstsq(white[:, :-1], white[:, -1], rcond=None)[0]
        levels.append(level)
        roots.append(root / likelihood.scale(values, which, noise))
    across = np.array([np.linalg.svd(one[np.newaxis])[2][1:] for one in up])

    def left(x: FloatArray) -> FloatArray:
        rate = EARTH_DPH * DPH * np.sin(x[3]) * up
        level = np.array([np.cos(x[4:]), np.sin(x[4:])]).T[:, :, np.newaxis] * across
        rate = rate + EARTH_DPH * DPH * np.cos(x[3]) * level.sum(axis=1)
        parts = [roots[at] @ (levels[at] - DPH * x[at] - rate[:, at]) for at in range(3)]
        return np.concatenate(parts)

    rng, level = np.random.default_rng(seed), np.array(levels).T / DPH
    starts = []
    for latitude in np.linspace(-1.4, 1.4, STARTS):
        constant = level.mean(axis=0) + rng.normal(0.0, 1.0, 3)
        seen = np.einsum("pka,pa->pk", across, level - constant)
        starts.append([*constant, latitude, *np.arctan2(seen[:, 1], seen[:, 0])])
    least = min(2.0 * least_squares(left, start).cost for start in starts)
    return float(least - (3 * len(up) - EARTHS) * likelihood.price)


def _seconds(run: RunBlocks, column: FloatArray) -> FloatArray:
    return np.asarray(np.floor(run.time_s[column > 0.5]), np.int64)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--first", type=int, default=71000)
    given = parser.parse_args(arguments)
    print(
        "| effect | floors | sessions | one axis, median | three axes, each session | noise known, one axis |"
    )
    print("|---|---|---|---|---|---|")
    for at, setting in enumerate(settings()):
        seeds = [1000 * at + given.first + number for number in range(given.repeat)]
        if setting.size != 2.0 or setting.poses:
            continue
        found = np.array([told(setting, seed) for seed in seeds])
        one, known = np.median(found.reshape(-1, 2), axis=0)
        three = ", ".join(f"{gain:.0f}" for gain in np.maximum(found[:, :, 0], 0.0).sum(axis=1))
        print(f"| {setting.label} | 2 | {len(seeds)} | {one:.0f} | {three} | {known:.0f} |", flush=True)
    for size in (0.0, 2.0, 5.0, 10.0):
        setting = Setting(("g_sensitivity",), size, poses=True, latitude_deg=50.0)
        gains = [beyond_earth(setting, given.first + number) for number in range(given.repeat)]
        said = ", ".join(f"{gain:.0f}" for gain in gains)
        print(
            f"| g_sensitivity, earth rate, heading unknown | {size:g} | {len(gains)} | | {said} | |",
            flush=True,
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
