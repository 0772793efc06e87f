"""The worked case of docs/closing-the-loop.md and its picture: residual, effect, remainder.

Three sessions of the scenario crs05-ramp-lag, whose gyros are 30 s behind their thermometers, as
`imumon simulate` makes them; the third is the test.
"""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import figures
from study import Options, Study, Table

from imumon.blocks import SampleBlock
from imumon.estimation.gyro_bias.stage import RestDetector
from imumon.geodesy import DEG_PER_H
from imumon.lab.diagnosis.conclusion import conclusion
from imumon.lab.diagnosis.diagnose import Diagnosis, diagnose
from imumon.lab.diagnosis.runs import Run, collect
from imumon.simulation.unit import SimulatedUnit, load_scenario

SCENARIO, RATE_HZ, CURVE = "crs05-ramp-lag", 10.0, "polynomial 5"
CHANNEL = "gyro_x"
MINUTE_S = 60.0


def session(seed: int) -> Run:
    """Return a simulated session as `imumon diagnose` reads it."""
    plan = load_scenario(SCENARIO).played(RATE_HZ, "FRD")
    sent = SimulatedUnit(plan, seed).run(plan.samples)[0]
    rest = RestDetector().process(sent)
    return collect([SampleBlock({**sent.columns, **rest})], f"S{seed}")[0]


def diagnosed() -> Diagnosis:
    """Return the diagnosis of the case."""
    return diagnose([session(1), session(2)], [session(3)], CURVE, sensors=("gyro",))


def tables(_: Options) -> Iterator[Table]:
    """Yield what the diagnosis reports of each channel."""
    found = diagnosed()
    lines = [conclusion(found), *(f"{verdict.name}: {verdict.summary}" for verdict in found.verdicts)]
    yield Table("", (), (), "\n".join(lines))


def draw(_: Options) -> Iterator[Path]:
    """Draw the steps of a channel: training, the effect beside it, and the test before and after."""
    verdict = next(one for one in diagnosed().verdicts if one.name == CHANNEL)
    titles = (
        "1 what the curve leaves, training",
        "2 the effect that follows it",
        "3 what is left of the test",
    )
    axes = figures.axes("", 1, 3, x="min since power-on", size=(11.0, 3.3))
    at = 0
    for run in verdict.channel.train:
        minutes, rows = run.time_s / MINUTE_S, slice(at, at + len(run))
        before, after = (fit.train[rows] / DEG_PER_H for fit in (verdict.before, verdict.after))
        name = "" if at else verdict.claims[0].finding.name
        axes[0].plot(minutes, before, ".", ms=4, label=run.name)
        axes[1].plot(minutes, before, ".", ms=4)
        axes[1].plot(minutes, before - after, "k-", lw=1.2, label=name)
        at += len(run)
    (test,) = verdict.channel.test
    scores = {"curve alone": (verdict.test_before, "C3."), "with the effect": (verdict.test_after, "C2.")}
    for label, (score, style) in scores.items():
        name = f"{label}: {score.rms / DEG_PER_H:.3g} °/h"
        axes[2].plot(test.time_s / MINUTE_S, score.residual[0] / DEG_PER_H, style, ms=4, label=name)
    floor = verdict.channel.floor.sd / DEG_PER_H
    for one, title in zip(axes, titles, strict=True):
        label = "white noise of a mean" if one is axes[2] else ""
        one.axhspan(-floor, floor, color="0.85", zorder=0, label=label)
        one.set_title(title, fontsize=9)
        one.sharey(axes[0])
    axes[0].set_ylabel(f"{verdict.name}, °/h")
    yield figures.save(axes, "closing-the-loop", "steps")


STUDY = Study(tables, draw=draw)
