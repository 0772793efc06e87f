"""``imumon doctor``, ``ports``, ``devices``, ``plugins``: what there is on this computer."""

from __future__ import annotations

from dataclasses import asdict
from pathlib import Path

import click

from imumon.cli.common import PATH, json_option, note, print_json, print_listing, show
from imumon.errors import EXIT_NEGATIVE, EXIT_OK

COLOURS = {"good": "green", "warning": "yellow", "fault": "red"}


@click.command("doctor")
@click.argument("folder", type=PATH, default=Path("sessions"))
@json_option
def doctor(folder: Path, as_json: bool) -> int:
    """Check packages, compiled code, disk, ports, viewer and display, and print what to do.

    \b
    imumon doctor

    FOLDER is where sessions are written.  Exits with 1 when something does not work.
    """
    from imumon.run.doctor import State, examine

    findings = list(examine(folder))
    faults = sum(finding.state is State.FAULT for finding in findings)
    if as_json:
        found = [{**finding._asdict(), "state": finding.state.value} for finding in findings]
        print_json({"findings": found, "faults": faults})
    for finding in () if as_json else findings:
        click.echo(click.style(f"{finding.state.value:<8}", fg=COLOURS[finding.state.value]), nl=False)
        show(f"{finding.subject}: {finding.seen}")
        if finding.remedy:
            show(f"{'':<8}  -> {finding.remedy}")
    return EXIT_NEGATIVE if faults else EXIT_OK


@click.command("ports")
@json_option
def ports(as_json: bool) -> None:
    """List serial ports with their USB ids, and whether they can be opened.

    \b
    imumon ports
    """
    from imumon.transport.ports import list_ports

    found = list_ports()
    if not found and not as_json:
        note("no serial ports exist; imumon virtual makes one without hardware")
    lines = []
    for port in found:
        facts = {
            "stable name": port.by_id,
            "driver": port.driver,
            "serial number": port.serial_number,
            "latency timer": f"{port.latency_timer_ms} ms" if port.latency_timer_ms is not None else None,
            "open in": ", ".join(port.holders),
            "access": None if port.accessible else "not for this user",
        }
        lines += [str(port), *(f"    {label:<14} {text}" for label, text in facts.items() if text)]
    print_listing(as_json, {"ports": [{**asdict(port), "usb_id": port.usb_id} for port in found]}, lines)


@click.command("devices")
@click.argument("name", required=False)
@json_option
def devices(name: str | None, as_json: bool) -> None:
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
    data: dict[str, object] = {}
    lines = []
    for device in map(load_device, device_names()):
        rates = list(device.serial.baudrates)
        facts = device.model_dump(include={"title", "verified", "protocol", "rate_hz", "axes"})
        data[device.name] = facts | {"baudrates": rates}
        lines.append(f"{device.name:<14} {device.title} ({device.protocol}, {rates[0]} baud)")
        lines.append(f"{'':<14} checked against {device.verified}")
    print_listing(as_json, data, lines)


@click.command("plugins")
@json_option
def plugins(as_json: bool) -> int:
    """List the plug-ins with their packages, what each brings, and whether it loads.

    \b
    imumon plugins

    Exits with 1 when one does not load.
    """
    from imumon.run.doctor import installed

    found = installed()
    lines = [] if found else ["no plug-ins"]
    for plugin in found:
        lines.append(f"{plugin.name:<14} {plugin.group} of {plugin.package} {plugin.version}".rstrip())
        brings = f"loads; brings {', '.join(plugin.brings) or 'nothing'}"
        lines.append(f"{'':<14} {f'does NOT load: {plugin.problem}' if plugin.problem else brings}")
    print_listing(as_json, {"plugins": [asdict(plugin) for plugin in found]}, lines)
    return EXIT_NEGATIVE if any(plugin.problem for plugin in found) else EXIT_OK
