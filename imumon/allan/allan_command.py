"""``imumon allan``: the noise of a unit at rest, from a recording."""

import math
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imumon.cli.common import (
    json_option,
    path_argument,
    path_option,
    print_json,
    print_rows,
    print_table,
    show,
    warn,
)
from imumon.cli.progress import reading_bar
from imumon.files import check_outputs

if TYPE_CHECKING:
    from .analysis import Result


@click.command("allan")
@path_argument("recording", metavar="SESSION|TABLE")
@path_option("--plot", help="Draw the curves, log-log, into this PNG.")
@path_option("--noise-out", help="Write the terms as the noise section of a pipeline YAML.")
@path_option("--kalibr", help="Write the terms as Kalibr's imu.yaml.")
@json_option
def command(
    recording: Path, plot: Path | None, noise_out: Path | None, kalibr: Path | None, as_json: bool
) -> None:
    """Estimate noise, bias instability and drift of a recording at rest.

    \b
    imumon allan sessions/NAME --plot allan.png

    SESSION is recorded or imported; TABLE is a Parquet or CSV table that imumon wrote.  The terms of
    the noise are fitted to the whole curve of overlapping Allan deviations, and printed with their standard
    deviations.
    """
    from . import output
    from .analysis import analyse
    from .recording import read_channels

    check_outputs(plot, noise_out, kalibr)
    with reading_bar([recording], quiet=as_json) as progress:
        opened = read_channels(recording, progress.count)
        progress("deviations and terms of all channels")
        results = analyse(opened.series)
    warn([*opened.warnings, *output.remarks(results)])
    if plot is not None:
        from .plot import write_plot

        write_plot(plot, results, recording)
    if noise_out is not None:
        output.write_noise(noise_out, results, recording)
    if kalibr is not None:
        output.write_kalibr(kalibr, results, recording)
    if as_json:
        print_json(output.as_json(results))
    else:
        _show_terms(results)
    written = {"plot": plot, "noise": noise_out, "kalibr": kalibr}
    print_rows({name: str(path) for name, path in written.items() if path is not None})


def _show_terms(results: "dict[str, Result]") -> None:
    from rich.table import Column

    from .covariance import TERMS_OF

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


def _with_sd(result: "Result", term: str, factor: float) -> str:
    """Return the value with two digits of its standard deviation behind it: 1.234(56)."""
    estimate = result.term(term)
    if estimate is None:
        return "-"
    value, sd = factor * estimate.value, factor * estimate.sd
    digits = min(max(1 - math.floor(math.log10(sd)), 0), 9)
    return f"{value:.{digits}f}({sd * 10**digits:.0f})"
