"""``imumon virtual``: a device without hardware."""

from __future__ import annotations

import signal
import threading
from pathlib import Path

import click

from imumon.cli.common import device_help, say
from imumon.protocols.device import load_device
from imumon.simulation.virtual_device import VirtualDevice


@click.command("virtual")
@click.option("--device", default="ax1", show_default=True, help=device_help)
@click.option("--link", type=click.Path(path_type=Path), help="Symlink to make to the port.")
@click.option("--rate", type=click.FloatRange(min=0, min_open=True), help="Packets per second.")
@click.option("--seed", default=0, show_default=True, help="Seed of the simulated noise.")
@click.option("--seconds", type=click.FloatRange(min=0, min_open=True), help="Stop after this time.")
def command(device: str, link: Path | None, rate: float | None, seed: int, seconds: float | None) -> None:
    """Be a device: a simulated AHRS on a real pseudo-terminal, until Ctrl-C.

    The name of the port is printed on standard output; open it like any serial port.
    """
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: ended.set())
    with VirtualDevice(load_device(device), link, rate, seed) as virtual:
        click.echo(virtual.port.path)
        ended.wait(seconds)
    say("INFO", f"sent {virtual.packets_sent:,} packets; {virtual.port.bytes_lost:,} bytes had no reader")
