"""``imumon demo``, ``virtual``, ``simulate``: devices and sessions without hardware."""

import signal
import subprocess
import sys
import tempfile
from inspect import cleandoc
from pathlib import Path
from textwrap import fill

import click

from imumon.cli.common import (
    SECONDS,
    Number,
    device_help,
    json_option,
    log,
    path_option,
    print_result,
    seed_option,
    serial_option,
    show,
)
from imumon.cli.progress import announce, bar
from imumon.errors import bad_config
from imumon.files import bundled

DEVICE = "ax1"
"""The one that is simulated when none is named."""
STARTING_S, SAMPLES_PER_S = 1.0, 250_000.0
"""For the estimate of the time: measured with `crs05-soak` on one core, 600,000 samples in 2.4 s."""
STOP = {signal.SIGINT, signal.SIGTERM}
TABLES = (".parquet", ".csv")
OTHERS = (".mat", ".mcap", ".npz", ".h5", ".json", ".txt", ".xls", ".xlsx")
"""Suffixes of files that are not written, and would become folders."""


@click.command("demo", context_settings={"ignore_unknown_options": True})
@click.argument("options", nargs=-1, type=click.UNPROCESSED, metavar="[OPTIONS OF MONITOR]...")
@click.pass_context
def demo(context: click.Context, options: tuple[str, ...]) -> int:
    """Watch a virtual AHRS that is turned by hand: to see imumon at work, without hardware.

    \b
    imumon demo                                  # until Ctrl-C
    imumon demo --seconds 20 --view terminal     # without a display

    The options are those of `imumon monitor`.
    """
    from imumon.cli.monitor_command import command
    from imumon.protocols.device import load_device

    from .virtual_device import VirtualDevice

    try:
        device = command.make_context("demo", ["PORT", "--device", DEVICE, *options]).params["device"]
    except click.UsageError as error:
        error.ctx = context  # the usage is that of this command
        raise
    described = load_device(device)
    # Ctrl-C before the monitor is ready waits until it is, so that every run ends with a summary.
    signal.pthread_sigmask(signal.SIG_BLOCK, STOP)
    with (
        tempfile.TemporaryDirectory(prefix="imumon-demo-") as folder,
        VirtualDevice(described, Path(folder) / "ahrs") as simulated,
    ):
        arguments = ["monitor", simulated.port.path, "--device", device, *options]
        with subprocess.Popen([sys.executable, "-m", "imumon", *arguments]) as monitor:
            for number in STOP:  # Ctrl-C in a terminal reaches the monitor anyway, and twice does no harm
                signal.signal(number, lambda *_: monitor.send_signal(signal.SIGINT))
            signal.pthread_sigmask(signal.SIG_UNBLOCK, STOP)
            code = monitor.wait()
    if simulated.failure is not None:  # the monitor only knows that nothing came
        raise simulated.failure
    return code


@click.command("virtual")
@click.option("--device", default=DEVICE, show_default=True, help=device_help)
@click.option("--scenario", help="Unit and motion: a name of the list above, or a file; default: bench.")
@path_option("--link", help="Symbolic link to the port, which imumon makes.")
@click.option("--rate", type=Number(min=0, min_open=True, max=1e5), help="Packets per second.")
@seed_option
@click.option("--seconds", type=SECONDS, help="Stop after this time.")
def virtual(
    device: str, scenario: str | None, link: Path | None, rate: float | None, seed: int, seconds: float | None
) -> None:
    """Be a device: a simulated AHRS on a port of its own, until Ctrl-C.

    \b
    imumon virtual --link ./ahrs                # in one terminal
    imumon monitor ./ahrs --device ax1          # in another

    The port is a pseudo-terminal, which programs open like any serial port.  Its name is printed on standard
    output.

    {scenarios}
    """
    from imumon.cli.live_run import Ending
    from imumon.protocols.device import load_device

    from .unit.scenario import load_scenario
    from .virtual_device import VirtualDevice

    ending = Ending(seconds)
    played = None if scenario is None else load_scenario(scenario)
    with VirtualDevice(load_device(device), link, rate, seed, scenario=played) as simulated:
        show(simulated.port.path)
        ending.begin()
        while simulated.failure is None and ending.wait():
            pass
    log("INFO", f"sent {simulated.packets_sent:,} packets; {simulated.port.bytes_lost:,} bytes had no reader")
    if simulated.failure is not None:
        raise simulated.failure


@click.command("simulate")
@click.argument("scenario")
@click.option("--device", help=f"{device_help}  Default: {DEVICE} for a session.")
@path_option("--out", required=True, help="Session folder to make; or a table: NAME.parquet or NAME.csv.")
@serial_option
@seed_option
@click.option("--duration", type=SECONDS, help="Length of the simulation; default: that of the scenario.")
@click.option(
    "--rate",
    type=Number(min=0, min_open=True, max=10_000),
    help="Packets per second; default: those of the scenario.",
)
@json_option
def simulate(
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
    from imumon.protocols.device import device_text, parse_device
    from imumon.recordings.folder import TRUTH_NAME, name_unit

    from .recording import record_session, write_table
    from .unit import load_scenario

    given = {"duration_s": duration, "rate_hz": rate}
    plan = load_scenario(scenario).model_copy(update={k: v for k, v in given.items() if v is not None})
    text, source = device_text(device or DEVICE)
    described, as_table = parse_device(text, source), out.suffix in TABLES
    if not as_table and out.suffix.lower() in (*TABLES, *OTHERS):
        raise bad_config(
            f"{out}: simulate writes no such file: a table is NAME.parquet or NAME.csv, a session a folder",
            "imumon export writes the other formats of a session",
        )
    if as_table and serial is not None:
        raise bad_config(f"{out}: a table has no serial number", "leave --serial away, or make a session")
    if device is not None or not as_table:  # in the axes of the device
        plan = plan.played(plan.rate_hz, described.axes)
    expected_s = STARTING_S + plan.samples / SAMPLES_PER_S
    announce("simulating", plan.samples, plan.samples / plan.rate_hz, expected_s, quiet=as_json)
    result = {"table": out} if as_table else {"session": out, "truth": out / TRUTH_NAME}
    with bar("simulating", plan.samples, quiet=as_json) as progress:
        if as_table:
            write_table(plan, seed, out, progress.count)
        else:
            record_session(plan, described, text, seed, out, progress.count)
            name_unit(out, serial)
    rows = {"samples": f"{plan.samples:,} at {plan.rate_hz:g} Hz"} | {k: str(v) for k, v in result.items()}
    print_result(as_json, {"scenario": scenario, "seed": seed, "samples": plan.samples, **result}, rows)


SCENARIOS = fill(f"Scenarios: {', '.join(sorted(bundled('scenarios')))}.", 78, break_on_hyphens=False)
for _command in (virtual, simulate):
    _command.help = cleandoc(str(_command.help)).format(scenarios=f"\b\n{SCENARIOS}")
