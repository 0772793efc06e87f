"""``imumon doctor``, ``ports``, ``detect``, ``devices``, ``plugins``: what there is on this computer."""

import json
from collections.abc import Mapping
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

import click

from imumon.errors import EXIT_NEGATIVE, EXIT_OK, EXIT_PORT, ImumonError, Reason
from imumon.files import check_output, plain, results_folder, write_text
from imumon.version import __version__

from .common import (
    SECONDS,
    Whole,
    device_help,
    json_option,
    note,
    path_argument,
    path_option,
    print_json,
    print_listing,
    print_table,
    show,
)

if TYPE_CHECKING:
    from imumon.transport.detect import Evidence
    from imumon.transport.settings import PortSettings


@click.command("doctor")
@path_argument("folder", default=Path("sessions"))
@json_option
def doctor(folder: Path, as_json: bool) -> int:
    """Check packages, compiled code, disk, ports, viewer and display, and print what to do.

    \b
    imumon doctor

    FOLDER is where sessions are written.  Exits with 1 when something does not work.
    """
    from imumon.run.doctor import examine

    findings = list(examine(folder))
    faults = sum(finding.state == "fault" for finding in findings)
    lines = []
    for finding in findings:
        lines.append(f"{finding.state:<8}{finding.subject}: {finding.seen}")
        if finding.remedy:
            lines.append(f"{'':<8}  -> {finding.remedy}")
    data = {"findings": [finding._asdict() for finding in findings], "faults": faults}
    print_listing(as_json, data, lines)
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
        show(device_text(name)[0].rstrip())
        return
    data: dict[str, object] = {}
    lines = []
    for device in map(load_device, device_names()):
        rates = list(device.serial.baudrates)
        facts = device.model_dump(include={"title", "verified", "protocol", "rate_hz", "axes"})
        data[device.name] = {**facts, "baudrates": rates}
        lines += [
            f"{device.name:<14} {device.title} ({device.protocol}, {rates[0]} baud)",
            f"{'':<14} checked against {device.verified}",
        ]
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
    print_listing(as_json, {"plugins": [plugin._asdict() for plugin in found]}, lines)
    return EXIT_NEGATIVE if any(plugin.problem for plugin in found) else EXIT_OK


@click.command("detect")
@click.argument("port")
@click.option("--device", "names", multiple=True, help=device_help + "  May be repeated; default: all.")
@click.option("--baud", "rates", multiple=True, type=Whole(min=1), help="Rate to try; may be repeated.")
@click.option("--seconds", default=1.5, show_default=True, type=SECONDS, help="Time at each rate.")
@click.option(
    "--propose",
    "proposed",
    type=click.Path(dir_okay=False, path_type=Path),
    help="Write the proposed device file of an unknown device here; the file must not exist.",
)
@path_option(
    "--save",
    "folder",
    metavar="FOLDER",
    help="Keep the bytes of each baud rate (RATE.bin) and evidence.json in a new folder, to report a device.",
)
@json_option
def detect(
    port: str,
    names: tuple[str, ...],
    rates: tuple[int, ...],
    seconds: float,
    proposed: Path | None,
    folder: Path | None,
    as_json: bool,
) -> int:
    """Find baud rate and protocol of the device on PORT by trying, and show the evidence.

    \b
    imumon detect /dev/ttyUSB0
    imumon detect /dev/ttyUSB0 --save device-report   # to report a device

    The port is opened at one baud rate after the other, and every known device is tried on the bytes that
    arrive.  If the device is unknown but sends lines of text or binary packets of fixed length, imumon
    proposes a device file with its reasons: check it, and give its path as --device.

    Exit code 0: a device was found.  3: the port cannot be opened, no bytes arrived, or the bytes are
    not packets of any device that was tried.
    """
    from imumon.protocols.device import device_names, load_device
    from imumon.transport.detect import WRONG_CHECKSUM, Verdict, baudrates_to_try, failure, is_wrong_checksum
    from imumon.transport.detect import detect as try_devices

    if proposed is not None:
        check_output(proposed)
    if folder is not None and folder.exists() and not (folder.is_dir() and not any(folder.iterdir())):
        raise ImumonError(Reason.EXISTS, f"{folder} is there already", "give the name of a new folder")
    received = dict[int | None, bytearray]()

    def begin(settings: "PortSettings") -> bytearray:
        rate = settings.baudrate if settings.has_line else None
        note(f"listening to {settings.url if rate is None else f'{rate} baud'}")
        received[rate] = bytearray()
        return received[rate]

    devices = {name: load_device(name) for name in names or device_names()}
    own_rates = [rate for device in devices.values() for rate in device.serial.baudrates[:1]]
    evidence = try_devices(
        port,
        {name: device.decoder for name, device in devices.items()},
        list(rates) or baudrates_to_try(own_rates),
        seconds,
        begin,
    )
    wrong = failure(port, evidence)
    fit = [item for item in evidence if item.verdict is Verdict.FRAMES]
    proposal = _propose(received, evidence) if wrong else None
    found = [{"device": item.protocol, "baudrate": item.baudrate} for item in fit]
    rows = [{**asdict(e), "share_framed": e.share_framed, "verdict": e.verdict.value} for e in evidence]
    data = {"found": next(iter(found), None), "fit": found, "evidence": rows, "proposal": proposal}
    if folder is not None:
        _save(folder, received, data)
    if as_json:
        print_json(data)
    else:
        _show(evidence)
        if len(fit) > 1:
            show("\nmore than one fits; the columns and their units show which it is")
        for item in fit:
            rate = f" --baud {item.baudrate}" if item.baudrate is not None else ""
            show(f"\n{item.protocol}: imumon monitor {port} --device {item.protocol}{rate}")
        near = max(evidence, key=lambda item: item.checksum_errors)
        protocol = devices[near.protocol].protocol if wrong and names else ""
        if is_wrong_checksum(protocol, near.checksum_errors, near.bytes_received):
            show(f"\n{near.protocol}: {near.checksum_errors:,} right headers: {WRONG_CHECKSUM}")
        if proposal:
            show(f"\nno device file describes what came; this one may:\n\n{proposal}")
    if wrong is None:
        return EXIT_OK
    if proposal is None:
        raise wrong
    if proposed is not None:
        write_text(proposed, proposal)
    todo = f"imumon monitor {port} --device {proposed or 'FILE, which --propose FILE writes'}"
    note(f"no known device: complete the proposed file, then: {todo}")
    return EXIT_PORT


def _save(folder: Path, received: Mapping[int | None, bytearray], data: Mapping[str, object]) -> None:
    """Write the bytes of each rate, and what was found in them, without the name of computer or port."""
    names = {rate: "port.bin" if rate is None else f"{rate}.bin" for rate in received}
    with results_folder(folder):
        for rate, name in names.items():
            (folder / name).write_bytes(received[rate])
        facts = {"imumon": __version__, "files": [*names.values()], **data}
        write_text(folder / "evidence.json", json.dumps(plain(facts), indent=2) + "\n")
    note(f"{folder} has the bytes of {len(names)} baud rate(s) and evidence.json")


def _propose(received: dict[int | None, bytearray], evidence: "list[Evidence]") -> str | None:
    """Return a device file for lines of text, or for binary packets of fixed length at one of the rates."""
    from imumon.protocols import binary_proposal, text_proposal
    from imumon.transport.detect import Verdict

    last = max(evidence, key=lambda item: (item.tells_the_rate, item.text_share))
    if last.tells_the_rate:
        return text_proposal.propose(bytes(received[last.baudrate]), last.seconds, last.baudrate)
    if any(item.verdict is Verdict.PARTLY for item in evidence):
        return None  # a known device whose bytes are damaged
    seconds = {item.baudrate: item.seconds for item in evidence}
    tried = [
        binary_proposal.propose(bytes(data), seconds[rate], rate)
        for rate, data in received.items()
        if rate in seconds
    ]
    fits = filter(None, tried)  # without a line all do: the first tried is usual
    found = max(fits, key=lambda one: (one.checked, one.checked or one.covered), default=None)
    return found.text if found is not None else None


def _show(evidence: "list[Evidence]") -> None:
    """Write the candidates with valid packets, and how many others there are; without any, the best one."""
    from rich.table import Column

    shown = [item for item in evidence if item.packets] or evidence[:1]
    names = ("device", "baud", "bytes/s", "packets", "samples", "framed", "damaged", "verdict")
    rows = (
        (
            item.protocol,
            "-" if item.baudrate is None else str(item.baudrate),
            f"{item.bytes_per_s:.0f}",
            str(item.packets),
            str(item.samples),
            f"{item.share_framed:.0%}",
            str(item.checksum_errors),
            item.verdict.value,
        )
        for item in shown
    )
    print_table([Column(name, no_wrap=name != names[-1]) for name in names], rows)
    if len(evidence) > len(shown):
        show(f"{len(evidence) - len(shown)} others: no valid packets")
