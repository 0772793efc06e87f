"""The worked case of docs/closing-the-loop.md and its picture: residual, effect, remainder.

Three sessions of the scenario crs05-ramp-lag, whose gyros are 30 s behind their thermometers, as
`imumon simulate` makes them; the third is the test.

Usage: closing_the_loop --part steps
"""

from __future__ import annotations

from pathlib import Path

import matplotlib as mpl

from imumon.blocks import SampleBlock
from imumon.estimation.gyro_bias.stage import RestDetector
from imumon.geodesy import DEG_PER_H
from imumon.lab.diagnosis.conclusion import conclusion
from imumon.lab.diagnosis.diagnose import diagnose
from imumon.lab.diagnosis.runs import Run, collect
from imumon.lab.diagnosis.verdict import ChannelVerdict
from imumon.simulation.unit import SimulatedUnit, load_scenario

mpl.use("Agg")
from matplotlib import pyplot as plt

SCENARIO, RATE_HZ, CURVE = "crs05-ramp-lag", 10.0, "polynomial 5"
CHANNEL = "gyro_x"
MINUTE_S = 60.0


def session(seed: int) -> Run:
    """Return a simulated session as `imumon diagnose` reads it."""
    plan = load_scenario(SCENARIO).played(RATE_HZ, "FRD")
    unit = SimulatedUnit(plan, seed)
    sent = unit.run(plan.samples)[0]
    rest = RestDetector().process(sent)
    return collect([SampleBlock({**sent.columns, **rest})], f"S{seed}")[0]


def draw(verdict: ChannelVerdict, path: Path) -> None:
    """Draw the steps of a channel: training, the effect beside it, and the test before and after."""
    assert verdict.test_before is not None
    assert verdict.test_after is not None
    figure, axes = plt.subplots(1, 3, figsize=(11, 3.3), dpi=80, sharey=True, layout="constrained")
    at = 0
    for run in verdict.channel.train:
        minutes, rows = run.time_s / MINUTE_S, slice(at, at + len(run))
        before, after = (fit.train[rows] / DEG_PER_H for fit in (verdict.before, verdict.after))
        axes[0].plot(minutes, before, ".", ms=4, label=run.name)
        axes[1].plot(minutes, before, ".", ms=4)
        axes[1].plot(
            minutes,
            before - after,
            "-",
            lw=1.2,
            color="k",
            label="" if at else verdict.claims[0].finding.name,
        )
        at += len(run)
    (test,) = verdict.channel.test
    for score, label, colour in (
        (verdict.test_before, "curve alone", "#c0504d"),
        (verdict.test_after, "with the effect", "#1f4e79"),
    ):
        left = score.residual[0] / DEG_PER_H
        axes[2].plot(
            test.time_s / MINUTE_S,
            left,
            ".",
            ms=4,
            color=colour,
            label=f"{label}: {score.rms / DEG_PER_H:.3g} °/h",
        )
    floor = verdict.channel.floor.sd / DEG_PER_H
    titles = (
        "1 what the curve leaves, training",
        "2 the effect that follows it",
        "3 what is left of the test",
    )
    for one, title in zip(axes, titles, strict=True):
        one.axhspan(
            -floor, floor, color="0.85", zorder=0, label="white noise of a mean" if one is axes[2] else None
        )
        one.set(title=title, xlabel="min since power-on")
        one.legend(fontsize=8)
    axes[0].set_ylabel(f"{verdict.name}, °/h")
    figure.savefig(path)
    plt.close(figure)


def main(folder: Path) -> int:
    """Print the case and draw it into a folder."""
    found = diagnose([session(1), session(2)], [session(3)], CURVE, sensors=("gyro",))
    print(conclusion(found))
    for verdict in found.verdicts:
        print(f"{verdict.name}: {verdict.summary}")
    folder.mkdir(parents=True, exist_ok=True)
    draw(next(one for one in found.verdicts if one.name == CHANNEL), folder / "steps.png")
    return 0
