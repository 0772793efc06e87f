"""``imumon devices``: what can be given as --device."""

from __future__ import annotations

import click

from imumon.cli.common import json_option, print_json, show


@click.command("devices")
@click.argument("name", required=False)
@json_option
def command(name: str | None, as_json: bool) -> None:
    """List the devices that imumon knows; with NAME, print its file, to copy and change.

    \b
    imumon devices
    imumon devices xsens > mine.yaml
    """
    from imumon.protocols.device import device_names, device_text, load_device

    if name is not None:
        load_device(name)
        show(device_text(name)[0], newline=False)
        return
    devices = [load_device(known) for known in device_names()]
    if as_json:
        print_json(
            {
                device.name: {
                    "title": device.title,
                    "verified": device.verified,
                    "protocol": device.protocol,
                    "baudrates": list(device.serial.baudrates),
                    "rate_hz": device.rate_hz,
                    "axes": device.axes,
                }
                for device in devices
            }
        )
        return
    for device in devices:
        show(f"{device.name:<14} {device.title} ({device.protocol}, {device.serial.baudrates[0]} baud)")
        show(f"{'':<14} checked against {device.verified}")
