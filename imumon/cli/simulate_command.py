"""``imumon simulate``: a scenario as a session or a table, as fast as it can be computed."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from inspect import cleandoc
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imumon.cli.common import (
    PATH,
    SECONDS,
    Number,
    device_help,
    json_option,
    listed,
    print_json,
    print_rows,
    seed_option,
    serial_option,
)
from imumon.cli.progress import announce
from imumon.files import bundled

if TYPE_CHECKING:
    from imumon.simulation.unit import Scenario

DEFAULT_DEVICE = "ax1"
TABLES = (".parquet", ".csv")
STARTING_S, SAMPLES_PER_S = 1.0, 250_000.0
"""For the estimate of the time: measured with `crs05-soak` on one core, 600,000 samples in 2.4 s."""


@click.command("simulate")
@click.argument("scenario")
@click.option("--device", help=f"{device_help}  Default: {DEFAULT_DEVICE} for a session.")
@click.option(
    "--out", required=True, type=PATH, help="Session folder to make; or a table: NAME.parquet or NAME.csv."
)
@serial_option
@seed_option
@click.option("--duration", type=SECONDS, help="Length of the simulation; default: that of the scenario.")
@click.option(
    "--rate",
    type=Number(min=0, min_open=True, max=10_000),
    help="Packets per second; default: those of the scenario.",
)
@json_option
def command(
    scenario: str,
    device: str | None,
    out: Path,
    serial: str | None,
    seed: int,
    duration: float | None,
    rate: float | None,
    as_json: bool,
) -> None:
    """Simulate SCENARIO, a name or a file, and write the true values beside the samples.

    \b
    imumon simulate kitchen --out sessions/kitchen
    imumon simulate night --out night.parquet --seed 2

    A session holds the packets of the device and truth.parquet, which has one row a packet: bias, rate and
    temperature of the simulated unit.  A table has them in columns that begin with true_.

    {scenarios}

    docs/simulation.md describes them, and how to write one.
    """
    from imumon.recordings.folder import name_unit
    from imumon.simulation.unit import load_scenario

    given = {"duration_s": duration, "rate_hz": rate}
    plan = load_scenario(scenario).model_copy(update={k: v for k, v in given.items() if v is not None})
    result = _simulated(plan, device, seed, out, quiet=as_json)
    if "session" in result:
        name_unit(out, serial)
    if as_json:
        print_json({"scenario": scenario, "seed": seed, "samples": plan.samples, **result})
    print_rows(
        {"samples": f"{plan.samples:,} at {plan.rate_hz:g} Hz"} | {k: str(v) for k, v in result.items()}
    )


def _simulated(plan: Scenario, device: str | None, seed: int, out: Path, *, quiet: bool) -> dict[str, Path]:
    """Write a session or a table, in the axes of the device; return what was written."""
    from imumon.protocols.device import device_text, parse_device
    from imumon.simulation.recording import TRUTH_NAME, record_session, write_table

    text, source = device_text(device or DEFAULT_DEVICE)
    described, as_table = parse_device(text, source), out.suffix in TABLES
    if device is not None or not as_table:
        plan = plan.played(plan.rate_hz, described.axes)
    expected_s = STARTING_S + plan.samples / SAMPLES_PER_S
    announce("simulating", plan.samples, plan.samples / plan.rate_hz, expected_s, quiet=quiet)
    with _progress(plan.samples) as progress:
        if as_table:
            write_table(plan, seed, out, progress)
            return {"table": out}
        record_session(plan, described, text, seed, out, progress)
    return {"session": out, "truth": out / TRUTH_NAME}


@contextmanager
def _progress(samples: int) -> Iterator[Callable[[int], object]]:
    """Give a function that is told of samples done; it draws a bar where a person looks on."""
    if not sys.stderr.isatty():
        yield lambda _: None
        return
    with click.progressbar(length=samples, label="simulating", file=sys.stderr) as bar:
        yield bar.update


command.help = cleandoc(str(command.help)).format(scenarios=listed("Scenarios", sorted(bundled("scenarios"))))
