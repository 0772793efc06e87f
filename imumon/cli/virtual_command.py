"""``imumon virtual``: a device without hardware."""

from __future__ import annotations

from inspect import cleandoc
from pathlib import Path

import click

from imumon.cli.common import PATH, SECONDS, Number, device_help, listed, say, seed_option, show
from imumon.cli.live_run import Ending
from imumon.files import bundled


@click.command("virtual")
@click.option("--device", default="ax1", show_default=True, help=device_help)
@click.option("--scenario", help="Unit and motion: a name of the list above, or a file; default: bench.")
@click.option("--link", type=PATH, help="Symbolic link to the port, which imumon makes.")
@click.option("--rate", type=Number(min=0, min_open=True, max=1e5), help="Packets per second.")
@seed_option
@click.option("--seconds", type=SECONDS, help="Stop after this time.")
def command(
    device: str,
    scenario: str | None,
    link: Path | None,
    rate: float | None,
    seed: int,
    seconds: float | None,
) -> None:
    """Be a device: a simulated AHRS on a port of its own, until Ctrl-C.

    \b
    imumon virtual --link ./ahrs                # in one terminal
    imumon monitor ./ahrs --device ax1          # in another

    The port is a pseudo-terminal, which programs open like any serial port.  Its name is printed on standard
    output.

    {scenarios}
    """
    from imumon.protocols.device import load_device
    from imumon.simulation.unit.scenario import load_scenario
    from imumon.simulation.virtual_device import VirtualDevice

    ending = Ending(seconds)
    played = None if scenario is None else load_scenario(scenario)
    with VirtualDevice(load_device(device), link, rate, seed, scenario=played) as virtual:
        show(virtual.port.path)
        ending.begin()
        while virtual.failure is None and ending.wait():
            pass
    say("INFO", f"sent {virtual.packets_sent:,} packets; {virtual.port.bytes_lost:,} bytes had no reader")
    if virtual.failure is not None:
        raise virtual.failure


command.help = cleandoc(str(command.help)).format(scenarios=listed("Scenarios", sorted(bundled("scenarios"))))
