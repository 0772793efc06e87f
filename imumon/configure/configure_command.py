"""``imumon configure``: rate, outputs and baud rate of a device, only where a user requests it."""

import signal
from typing import TYPE_CHECKING

import click

from imumon.cli.common import (
    Number,
    Whole,
    device_help,
    json_option,
    log,
    note,
    print_json,
    print_rows,
    split_columns,
    warn,
)
from imumon.cli.live_run import ending_signals
from imumon.errors import bad_config

if TYPE_CHECKING:
    from .configuration import Report
    from .core import Family


@click.command("configure")
@click.argument("port")
@click.option("--device", required=True, help=device_help)
@click.option("--rate", type=Number(min=0.1, max=1e5), help="Samples per second.")
@click.option(
    "--outputs",
    help="Outputs, separated by commas: inertial, increments, magnetometer, temperature, pressure, attitude, "
    "status.  Time and counter are always on; outputs that are not listed are switched off.",
)
@click.option("--baud", type=Whole(min=1), help="New baud rate of the device.")
@click.option("--at", type=Whole(min=1), help="Present baud rate; default: found by trying.")
@click.option(
    "--save",
    is_flag=True,
    help="Keep the settings in the flash of the device; without it they are lost at power-off.",
)
@click.option("--dry-run", is_flag=True, help="Show what would be sent; the port is not even opened.")
@json_option
def command(
    port: str,
    device: str,
    rate: float | None,
    outputs: str | None,
    baud: int | None,
    at: int | None,
    save: bool,
    dry_run: bool,
    as_json: bool,
) -> None:
    """Set rate, outputs and baud rate of the device on PORT; without these, show its settings.

    \b
    imumon configure /dev/ttyUSB0 --device xsens                # settings
    imumon configure /dev/ttyUSB0 --device xsens --rate 200 --dry-run

    The settings are read before the change and again after it; then the data rate is measured.  If a step
    fails, or Ctrl-C ends it, the device gets its old settings back.  For xsens, microstrain, vectornav and
    witmotion.
    """
    from imumon.protocols.device import load_device

    from .command_link import connect
    from .configuration import Configuration, Report, planned
    from .core import Wish, family_of

    described = load_device(device)
    family = family_of(described)
    wish = Wish(rate, split_columns(outputs, "--outputs"), baud, save)
    family.check(wish)
    if save and wish.only_reads:
        raise bad_config("--save, but nothing to save", "give --rate, --outputs or --baud")
    line = described.port_settings(port, at)
    if baud is not None and not line.has_line:
        raise bad_config(f"{port} has no line with a baud rate", "leave --baud out")
    report = Report(described.name, port, verified=family.verified)
    if dry_run:
        report.plan = planned(family, wish, line)
        report.assumed, report.result = family.assumed, "planned"
        print_json(report.as_dict()) if as_json else _show_plan(report)
        return
    for number in ending_signals():
        signal.signal(number, signal.default_int_handler)
    link = connect(port, described, family, at)
    log("INFO", f"{family.title} answers on {link.port.settings}")
    try:
        Configuration(link, described, report, note).run(wish)
    finally:
        link.port.close()
        if as_json:
            print_json(report.as_dict())
        _show(report, family, str(link.port.settings))
    now = link.port.settings
    again = (
        f" --baud {now.baudrate}" if now.has_line and now.baudrate != described.serial.baudrates[0] else ""
    )
    note(f"to watch it: imumon monitor {port} --device {device}{again}")


def _show_plan(report: "Report") -> None:
    width = min(max(len(request.shown) for request in report.plan), 60)
    for request in report.plan:
        click.echo(f"{request.shown:<{width}}  {request.meaning}")
    for text in report.assumed:
        click.echo(f"assumed: {text}")
    click.echo(f"commands checked against: {report.verified}")
    note("dry run: nothing was sent, and the port was not opened")


def _show(report: "Report", family: "Family", line: str) -> None:
    rows = {"device": " ".join((family.title, *report.identity)), "line": line}
    for name, text in report.before.items():
        new = report.after[name] if report.result == "done" else text
        rows[name] = text if new == text else f"{new}, was: {text}"
    if report.stream is not None:
        rate = f"{report.stream.rate_hz:.4g} Hz" if report.stream.rate_hz else "too slow to be measured"
        rows["measured"] = f"{rate}: {', '.join(report.stream.columns)}"
    print_rows(rows)
    warn(report.warnings)
    if report.result == "failed":
        for text in report.restored:
            log("INFO", f"put back: {text}")
        for text in report.not_restored:
            log("ERROR", f"NOT put back: {text}")
        if report.not_restored and report.flash_begun:
            log("ERROR", "flash may hold the new settings: configure again when the device answers")
        elif report.not_restored:
            hint = "switch the device off and on, and it has its settings of before"
            log("ERROR", f"flash was not written: {hint}")
        elif not report.restored:
            log("INFO", "no setting was changed")
        return
    if report.result == "unchanged":
        log("INFO", "the device is set like this already")
    if report.saved:
        confirms = all(request.answer for request in family.save(()))
        sure = "" if confirms else ", if the device did it: its kind does not confirm it"
        log("INFO", f"saved: the settings survive power-off{sure}")
    elif report.result == "done":
        log("INFO", "not saved: the settings are lost at power-off (--save writes flash)")
