"""``imumon detect``: what is on this port?"""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from imumon.cli.common import SECONDS, device_help, json_option, note, print_json

if TYPE_CHECKING:
    from imumon.transport.detect import Evidence
    from imumon.transport.settings import PortSettings


@click.command("detect")
@click.argument("port")
@click.option("--device", "names", multiple=True, help=device_help + "  May be repeated; all when not given.")
@click.option(
    "--baud", "rates", multiple=True, type=click.IntRange(min=1), help="Rate to try; may be repeated."
)
@click.option(
    "--seconds", default=1.5, show_default=True, type=SECONDS, help="How long to listen at each rate."
)
@json_option
def command(port: str, names: tuple[str, ...], rates: tuple[int, ...], seconds: float, as_json: bool) -> None:
    """Find baud rate and protocol of the device on PORT by trying, and show the evidence.

    Exit code 0 when a device was found, 3 when nothing frames.
    """
    from imumon.protocols.device import device_names, load_device
    from imumon.transport.detect import baudrates_to_try, detect, failure

    devices = [load_device(name) for name in names or device_names()]
    own_rates = [rate for device in devices for rate in device.serial.baudrates[:1]]
    evidence = detect(
        port,
        {device.name: device.decoder for device in devices},
        list(rates) or baudrates_to_try(own_rates),
        seconds,
        before_rate=lambda settings: note(f"listening to {_where(settings)}"),
    )
    wrong = failure(port, evidence)
    best = None if wrong else evidence[0]
    if as_json:
        found = {"device": best.protocol, "baudrate": best.baudrate} if best else None
        rows = [{**asdict(e), "share_framed": e.share_framed, "verdict": e.verdict.value} for e in evidence]
        print_json({"found": found, "evidence": rows})
    else:
        _show(evidence)
        if best:
            rate = f" --baud {best.baudrate}" if best.baudrate is not None else ""
            click.echo(f"\n{best.protocol}: imumon monitor {port} --device {best.protocol}{rate}")
    if wrong:
        raise wrong


def _where(settings: PortSettings) -> str:
    return f"{settings.baudrate} baud" if settings.has_line else settings.url


def _show(evidence: list[Evidence]) -> None:
    from rich.box import SIMPLE
    from rich.console import Console
    from rich.table import Column, Table

    names = ("device", "baud", "bytes/s", "packets", "samples", "framed", "damaged", "verdict")
    table = Table(*(Column(name, no_wrap=True) for name in names), box=SIMPLE, padding=0)
    for item in evidence:
        table.add_row(
            item.protocol,
            "-" if item.baudrate is None else str(item.baudrate),
            f"{item.bytes_per_s:.0f}",
            str(item.packets),
            str(item.samples),
            f"{item.share_framed:.0%}",
            str(item.checksum_errors),
            item.verdict.value,
        )
    Console().print(table)
