"""``imumon rack``: many units on one bench, each recorded by a process of its own, watched together."""

import time
from collections import deque
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imumon.cli import common
from imumon.cli.live_run import Ending, Lines, watch
from imumon.errors import EXIT_NEGATIVE, EXIT_OK, ImumonError

if TYPE_CHECKING:
    from imumon.view.publisher import ViewPublisher


@click.command("rack")
@common.path_argument("file", metavar="RACK.YAML")
@common.live_view_option
@common.path_option("--out", default=Path("sessions"), show_default=True, help="Folder of the sessions.")
@common.seconds_option
@common.window_option
@common.bind_option
@common.json_option
def command(
    file: Path,
    view: common.View | None,
    out: Path,
    seconds: float | None,
    window: float,
    bind: str,
    as_json: bool,
) -> int:
    """Record all units that RACK.YAML names, each in a process and a session of its own, until Ctrl-C.

    \b
    imumon rack rack.yaml
    imumon rack rack.yaml --view terminal

    RACK.YAML lists the units:

    \b
        format: imumon-rack/1
        default: {device: xsens, baud: 921600}
        units:
          left: {port: /dev/ttyUSB0, serial: "0380123", model: left.yaml}
          right: {port: /dev/ttyUSB1}

    A unit whose port does not exist yet is waited for.  A process that ends or hangs is started again; the
    others go on.  The file is read again when it changes: new units start, removed units end.
    """
    from .rack.description import changes, load_rack
    from .rack.rack import Rack
    from .rack.table import in_short, text_lines

    mode = common.chosen_view(view, bind)
    changed = changes(file)
    next(changed)  # those from here on
    plans = load_rack(file)
    ending, lines = Ending(seconds), Lines()
    publisher = _publisher(file, mode, window, bind)
    rack = Rack(out, lines.put, publisher.publish if publisher else lambda _: None)
    log: deque[str] = deque(maxlen=100)  # more lines than a terminal shows below the table, the newest first

    def step() -> None:
        rack.look()
        if next(changed):
            try:
                rack.change(load_rack(file))
            except ImumonError as error:  # a bad file changes nothing
                lines.put("ERROR", f"{error.line}; the rack goes on as it is")
        if publisher is not None:
            publisher.announce(lines.put)

    def status() -> str:
        return in_short(rack.rows) + ("" if publisher is None else f"  view: {publisher.text}")

    def screen(*_: int) -> list[str]:
        log.extendleft(f"{level} {text}" for _, level, text in lines.take())
        return [f"rack {file.stem}: {in_short(rack.rows)}", "", *text_lines(rack.rows), "", *log]

    try:
        rack.change(plans)
        ending.begin()
        watch(ending, lines, step, status, screen if mode == "terminal" else None)
    finally:
        rack.stop()
        if publisher is not None:
            publisher.close()
        lines.write()
    units = rack.as_dict()
    if as_json:
        common.print_json({"units": units, "view_dropped": 0 if publisher is None else publisher.dropped})
    for line in text_lines(rack.rows):
        common.note(line)
    troubles = {name: text for name, unit in units.items() if (text := trouble(unit))}
    common.print_rows({"sessions": str(out), **troubles})
    return EXIT_NEGATIVE if troubles else EXIT_OK


def _publisher(file: Path, mode: common.View, window: float, bind: str) -> "ViewPublisher | None":
    """Return the view that all units share, where there is one."""
    if mode == "terminal" or mode == "none":
        return None
    from imumon.view.items import ViewSetup
    from imumon.view.publisher import ViewPublisher

    setup = ViewSetup(
        title=f"rack {file.stem}", recording_id=f"rack-{file.stem}-{time.time_ns()}", window_s=window
    )
    return ViewPublisher(mode, setup, bind=bind, module="imumon.fleet.rack.view").start()


def trouble(unit: dict[str, Any]) -> str:
    """Return what went wrong with a unit, by what ``--json`` holds of it; empty when nothing did."""
    unrecorded = sum(session["bytes_unrecorded"] for session in unit["sessions"])
    died = f"its process died {len(unit['deaths'])} times" if unit["deaths"] else ""
    lost = f"NOT RECORDED: {unrecorded:,} bytes" if unrecorded else ""
    return "; ".join(filter(None, (unit["problem"], died, lost)))
