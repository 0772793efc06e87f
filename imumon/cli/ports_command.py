"""``imumon ports``: which serial ports there are."""

from __future__ import annotations

from dataclasses import asdict

import click

from imumon.cli.common import json_option, note, print_json, show


@click.command("ports")
@json_option
def command(as_json: bool) -> None:
    """List serial ports with their USB ids, and whether they can be opened.

    \b
    imumon ports
    """
    from imumon.transport.ports import list_ports

    ports = list_ports()
    if as_json:
        print_json({"ports": [{**asdict(port), "usb_id": port.usb_id} for port in ports]})
        return
    if not ports:
        note("no serial ports exist; imumon virtual makes one without hardware")
        return
    for port in ports:
        show(str(port))
        facts = {
            "stable name": port.by_id,
            "driver": port.driver,
            "serial number": port.serial_number,
            "latency timer": f"{port.latency_timer_ms} ms" if port.latency_timer_ms is not None else None,
            "open in": ", ".join(port.holders),
            "access": None if port.accessible else "not for this user",
        }
        for label, text in facts.items():
            if text:
                show(f"    {label:<14} {text}")
