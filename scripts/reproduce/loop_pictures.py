"""The worked case of docs/closing-the-loop.md in three steps, and what the measured chamber record lacks.

The case: three sessions of the scenario crs05-ramp-lag, whose gyros are 30 s behind their thermometers, as
`imumon simulate` makes them; the third is the test.
"""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
from closing_the_loop_measured import chamber_run
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from study import ROOT

from imumon.blocks import SampleBlock
from imumon.estimation.gyro_bias.stage import RestDetector
from imumon.geodesy import DEG_PER_H
from imumon.lab.diagnosis.diagnose import diagnose
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


def steps() -> list[Axes]:
    """Draw the steps of a channel: training, the effect beside it, and the test before and after."""
    found = diagnose([session(1), session(2)], [session(3)], CURVE, sensors=("gyro",))
    verdict = next(one for one in found.verdicts if one.name == CHANNEL)
    figure = Figure(figsize=(11.0, 3.3), dpi=80)
    residual, effect, test = figure.subplots(1, 3, sharey=True)
    at = 0
    for run in verdict.channel.pool.runs:
        minutes, rows = run.time_s / MINUTE_S, slice(at, at + len(run))
        before, after = (fit.train[rows] / DEG_PER_H for fit in (verdict.before, verdict.after))
        residual.plot(minutes, before, ".", ms=4, label=run.name)
        effect.plot(minutes, before, ".", ms=4)
        name = "" if at else verdict.claims[0].finding.name
        effect.plot(minutes, before - after, "k-", lw=1.2, label=name)
        at += len(run)
    (last,) = verdict.channel.test
    scores = {"curve alone": (verdict.test_before, "C3."), "with the effect": (verdict.test_after, "C2.")}
    for label, (score, style) in scores.items():
        name = f"{label}: {score.rms / DEG_PER_H:.3g} °/h"
        test.plot(last.time_s / MINUTE_S, score.residual[0] / DEG_PER_H, style, ms=4, label=name)
    floor = verdict.channel.floor.sd / DEG_PER_H
    titles = ("1 what the curve leaves", "2 the effect that follows it", "3 what is left of unused data")
    for one, title in zip((residual, effect, test), titles, strict=True):
        one.axhspan(-floor, floor, color="0.85", zorder=0, label="white noise" if one is test else "")
        one.set_title(title, fontsize=10)
        one.set_xlabel("minutes since power-on")
        one.grid(alpha=0.3)
    residual.set_ylabel(f"{CHANNEL}, °/h")
    return [residual, effect, test]


def chamber_cycle() -> list[Axes]:
    """Draw what a cubic leaves of each gyro of the measured record, and what is left with the effects."""
    folder = Path(os.environ.get("IMUMON_DATA", ROOT.parent / "shared" / "data"))
    found = diagnose([chamber_run(folder / "chamber-cycle")], (), "polynomial 3", sensors=("gyro",))
    figure = Figure(figsize=(11.0, 3.3), dpi=80)
    drawn = list(figure.subplots(1, 3))
    for one, verdict in zip(drawn, found.verdicts, strict=True):
        (run,) = verdict.channel.pool.runs
        effects = ", ".join(claim.finding.name for claim in verdict.claims) or "nothing named"
        for fit, style, name in ((verdict.before, "C3.", "cubic"), (verdict.after, "C2.", f"with {effects}")):
            one.plot(run.time_s / MINUTE_S, np.degrees(fit.train), style, ms=4, label=name)
        one.set_title(verdict.name, fontsize=10)
        one.set_xlabel("minutes")
        one.grid(alpha=0.3)
    drawn[0].set_ylabel("residual, °/s")
    return drawn
