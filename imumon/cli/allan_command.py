"""``imumon allan``: Allan deviations of a recording, and the noise terms behind them."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from pathlib import Path
from pkgutil import resolve_name
from typing import TYPE_CHECKING

import click

from imumon.cli.common import PATH, json_option, print_json, print_rows, print_table, show, warn
from imumon.cli.progress import reading_bar

if TYPE_CHECKING:
    from imumon.allan.analysis import Result


@click.command("allan")
@click.argument("recording", metavar="SESSION|TABLE", type=PATH)
@click.option("--plot", type=PATH, help="Draw the curves, log-log, into this PNG.")
@click.option("--noise-out", type=PATH, help="Write the terms as the noise section of a pipeline YAML.")
@click.option("--kalibr", type=PATH, help="Write the terms as Kalibr's imu.yaml.")
@click.option("--openvins", type=PATH, help="Write the terms as OpenVINS' kalibr_imu_chain.yaml.")
@click.option("--vins", type=PATH, help="Write the terms as VINS-Mono and VINS-Fusion have them.")
@json_option
def command(
    recording: Path, plot: Path | None, noise_out: Path | None, as_json: bool, **odometry: Path | None
) -> None:
    """Estimate noise, bias instability and drift of a recording at rest.

    \b
    imumon allan sessions/NAME --plot allan.png

    SESSION is recorded or imported; TABLE is a Parquet or CSV table that imumon wrote.  The terms of
    the noise are fitted to the whole curve of overlapping Allan deviations, and printed with their standard
    deviations.
    """
    from imumon.allan import output
    from imumon.allan.analysis import analyse
    from imumon.allan.odometry import write_kalibr, write_openvins, write_vins
    from imumon.allan.recording import read_channels
    from imumon.estimation.gyro_bias.stage import RestDetector

    output.check_outputs(plot, noise_out, *odometry.values())
    with reading_bar([recording], quiet=as_json) as tell:
        opened = read_channels(recording, lambda _: [RestDetector()], tell.count)
        tell("deviations and terms of all channels")
        results = analyse(opened.series)
    warn([*opened.warnings, *_of_the_fit(results)])
    writers: dict[str, Callable[[Path], None]] = {
        "plot": lambda path: resolve_name("imumon.allan.plot:write_plot")(path, results, str(recording)),
        "noise": lambda path: output.write_noise(path, results, recording),
        "kalibr": lambda path: write_kalibr(path, results, recording),
        "openvins": lambda path: write_openvins(path, results, recording),
        "vins": lambda path: write_vins(path, results, recording),
    }
    outputs = {name: path for name, path in ({"plot": plot, "noise": noise_out} | odometry).items() if path}
    for name, path in outputs.items():
        writers[name](path)
    if as_json:
        print_json(output.as_json(results))
    else:
        _show(results)
    print_rows({name: str(path) for name, path in outputs.items()})


def _of_the_fit(results: dict[str, Result]) -> list[str]:
    """Return warnings where the terms are from a part of the curve, or from none; channels together."""
    from imumon.allan.recording import UNITS, group_of

    channels: dict[str, list[str]] = {}
    for name, result in results.items():
        for remark, detail in _remarks(result, UNITS[group_of(name)]):
            channels.setdefault(remark, []).append(f"{name} {detail}".rstrip())
    return [f"{', '.join(names)}: {remark}" for remark, names in channels.items()]


def _remarks(result: Result, unit: str) -> Iterator[tuple[str, str]]:
    """Yield the warnings on the fit of a channel, each with its number."""
    from imumon.allan.fit import AMBIGUOUS, DIGITS, NO_SUM

    fit, digits = result.fit, result.digits
    if fit is None and result.allan.values.any():
        yield "too short for a fit of the terms", ""
    elif fit is None:
        yield "the reading never changes: the channel is stuck, or its resolution too coarse; no terms", ""
    if fit is None:
        return
    if fit.first:
        text = "shorter averaging times are not fitted: no sum of the terms describes them (a filter?)"
        yield text, f"{result.tau_s[fit.first]:.2g} s"
    if fit.withheld != DIGITS and fit.model_error > NO_SUM:
        text = "no sum of the terms describes the curve (a vibration, a cycle, motion?): no term is reported"
        yield text, ""
    elif fit.withheld != DIGITS and fit.model_error:
        text = "the curve differs so much from every sum of the terms; the standard deviations take that in"
        yield text, f"{50.0 * fit.model_error:.2g} %"
    if fit.last < result.trusted - 1:
        text = "no sum of the terms describes longer averaging times (a vibration, a cycle, motion?): "
        yield text + "only the angle random walk is reported", f"{result.tau_s[fit.last]:.2g} s"
    if fit.withheld == AMBIGUOUS:
        text = "correlated noise describes the curve as well as bias instability or a random walk: "
        yield text + "neither is reported; record for longer", ""
    if digits is None:
        return
    steps = f"{digits.step:.3g} {unit}, {1.0 / digits.ratio:.2g} times the noise"
    walk = fit.terms["angle_random_walk"]
    if fit.withheld == DIGITS:
        yield "the steps of the readings hide the noise: no term is reported", steps
    if walk is not None and 0.5 * digits.share * walk.value > walk.sd:
        text = "the steps of the readings add to the noise"
        yield text, f"{steps}, {digits.share:.0%} of the variance"


LARGE = 1e5
"""From here on a number is written with a power of ten."""


def _show(results: dict[str, Result]) -> None:
    from rich.table import Column

    from imumon.allan.parameters import TERMS_OF

    for group, terms in TERMS_OF.items():
        of_group = {name: result for name, result in results.items() if name.startswith(group)}
        found = of_group.values()
        level = terms["bias_instability"]
        rows = [
            [row.title, row.shown, *(_with_sd(result, term, row.factor) for result in found)]
            for term, row in terms.items()
        ]
        lowest = (f"{level.factor * result.allan.values[result.lowest]:.4g}" for result in found)
        rows.append(["lowest deviation", level.shown, *lowest])
        rows.append(["  at τ", "s", *(f"{result.tau_s[result.lowest]:.4g}" for result in found)])
        rows.append(["longest trusted τ", "s", *(f"{result.longest_tau_s:.4g}" for result in found)])
        if of_group:
            axes = [Column(name, justify="right", no_wrap=True) for name in of_group]
            print_table([Column(no_wrap=True), Column(no_wrap=True), *axes], rows)
    show("1.234(56): 1.234 with a standard deviation of 0.056.  -: not shown by the data.")
    show("Bias instability B: the flat part of the curve is 0.664 B.")


def _with_sd(result: Result, term: str, factor: float) -> str:
    """Return the value with two digits of its standard deviation behind it: 1.234(56)."""
    estimate = None if result.fit is None else result.fit.terms[term]
    if estimate is None:
        return "-"
    value, sd = factor * estimate.value, factor * estimate.sd
    power = math.floor(math.log10(value)) if value >= LARGE else 0
    value, sd = value / 10.0**power, sd / 10.0**power
    digits = min(max(1 - math.floor(math.log10(sd)), 0), 9)
    return f"{value:.{digits}f}({sd * 10**digits:.0f})" + (f"e{power}" if power else "")
