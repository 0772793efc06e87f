"""``imumon monitor``: connect, watch, record."""

import shlex
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from imumon.errors import EXIT_NEGATIVE, EXIT_OK, bad_config
from imumon.wing import offers

from . import common
from .live_run import PortRun, single_keys, watch

if TYPE_CHECKING:
    from imumon.run.live import LiveRun, LiveSummary
    from imumon.run.narration import Progress
    from imumon.view.items import ViewSetup


def _live_outputs(function: Callable[..., int]) -> Callable[..., int]:
    """Add the options that the wings bring."""
    for output in offers("live_output"):
        function = output.option(function)
    return function


@click.command("monitor")
@click.argument("port")
@click.option("--device", required=True, help=common.device_help)
@common.baud_option
@common.live_view_option
@common.session_option
@common.serial_option
@common.seconds_option
@click.option(
    "--learn",
    is_flag=True,
    help="Look for a bias model that is better than --model, run it beside, and keep it with the session if"
    " its errors are smaller.",
)
@common.setup_options
@_live_outputs
@common.window_option
@common.bind_option
@common.json_option
def command(
    port: str,
    device: str,
    baud: int | None,
    view: common.View | None,
    out: Path | None,
    serial: str | None,
    seconds: float | None,
    window: float,
    bind: str,
    learn: bool,
    as_json: bool,
    **options: Any,
) -> int:
    """Record the device on PORT and watch it live, until Ctrl-C or --seconds.

    \b
    imumon monitor /dev/ttyUSB0 --device xsens
    imumon monitor /dev/ttyUSB0 --device xsens --view none --seconds 3600

    PORT is a serial port (`imumon ports` lists them) or socket://host:port.  DEVICE is a name that
    `imumon devices` lists; `imumon detect` finds it.  Every byte received is kept.  When the device is
    unplugged or silent, imumon waits for it and opens it again.
    """
    from imumon.run.narration import view_setup
    from imumon.run.stages import keep_learned

    mode = common.chosen_view(view, bind)
    outputs = [(one, one.parse(options.pop(one.name))) for one in offers("live_output")]
    setup = common.make_setup(options)
    if learn:
        if setup.bias_model is None:
            raise bad_config(
                "--learn: there is no bias model that could be better",
                "add --model MODEL.yaml, made by: imumon calibrate SESSION... --out MODEL.yaml",
            )
        setup = setup.with_options(watch=setup.watch.model_copy(update={"learn": True}))
    live = PortRun(port, device, baud, setup, out, seconds, serial)
    run = live.run
    views: _Views | None = None
    try:
        # The view's process starts while this one gets ready.
        shown = view_setup(run.session, run.pipeline.units, window)
        views = _Views(shown, run, mode, bind, [one.start(given, shown) for one, given in outputs])
        live.begin(views.publish)
        _watch(live, views)
    finally:
        summary = run.stop(views.files if views is not None else ())
        if views is not None:
            views.close()
        live.lines.write()
    learned = keep_learned(run.pipeline, run.session) if setup.bias_model is not None else None
    data = {**summary.as_dict(), "view_dropped": views.dropped, "learned_model": learned}
    for output in views.outputs:
        data |= output.as_data
    rows = _rows(summary, run.progress, views)
    if learned is not None:
        rows["learned"] = str(learned)
    common.print_result(as_json, data, rows)
    live.raise_problem(summary)
    return EXIT_NEGATIVE if summary.wire.bytes_unrecorded else EXIT_OK


class _Views:
    """The live view, if any, the recording of the view, and what other programs get."""

    def __init__(
        self, setup: "ViewSetup", run: "LiveRun", mode: common.View, bind: str, outputs: Sequence[Any]
    ) -> None:
        from imumon.view.publisher import ViewPublisher
        from imumon.view.recorder import ViewRecorder
        from imumon.view.terminal import TerminalView

        self.terminal = TerminalView(setup) if mode == "terminal" else None
        self._live: ViewPublisher | None = None
        if mode == "native" or mode == "web":
            self._live = ViewPublisher(mode, setup, bind=bind).start()
        self._recorder = ViewRecorder(run.session.view_path, setup, on_error=run.report_view_error)
        self.outputs = outputs
        self._elsewhere = [*([self._live] if self._live else []), *outputs]
        self.publish = [one.publish for one in (self._recorder, self._live, self.terminal) if one is not None]
        self.publish += [publish for output in outputs for publish in output.publish]

    @property
    def files(self) -> list[str]:
        return [path.name for path in self._recorder.files if path.exists()]

    @property
    def dropped(self) -> int:
        return self._recorder.dropped + (self._live.dropped if self._live else 0)

    @property
    def text(self) -> str:
        """What the status line has of them."""
        return (f"  view: {self._live.text}" if self._live else "") + "".join(o.text for o in self.outputs)

    def announce(self, log: Callable[[str, str], None]) -> None:
        """Log where each is, as soon as it is known and when it changes."""
        for output in self._elsewhere:
            output.announce(log)

    def close(self) -> None:
        self._recorder.end()
        for output in reversed(self._elsewhere):
            output.close()
        self._recorder.close()


KEYS = "m: mark  s: start, stop"
"""What the keys do: m marks the moment, s starts a part of the recording or stops it."""


def _watch(live: PortRun, views: _Views) -> None:
    from imumon.transport.reader import EventKind

    run, lines, view = live.run, live.lines, views.terminal
    switches = 0

    def step() -> None:
        nonlocal switches
        for key in pressed() if pressed is not None else "":
            if key == "m":
                run.mark(EventKind.MARK, "key m")
            elif key == "s":
                run.mark(EventKind.STOP if switches % 2 else EventKind.START, f"part {switches // 2 + 1}")
                switches += 1
        views.announce(lines.put)

    def status() -> str:
        return status_line(run.progress) + views.text

    def screen(columns: int, rows: int) -> Sequence[str]:
        assert view is not None
        return view.lines(columns, rows, f"{status()}  {KEYS}")

    with single_keys() as pressed:
        if view is None and pressed is not None and common.is_terminal():
            lines.put("INFO", f"keys: {KEYS}")
        watch(live.ending, lines, step, status, None if view is None else screen)


def status_line(progress: "Progress") -> str:
    """Return the one line that a terminal shows while recording."""
    counters = progress.counters
    load = "" if progress.link_load is None else f"  link {progress.link_load:.0%}"
    lost = f"{'lost' if counters.packets_counted else 'damaged'} {counters.lost:,}"
    return (
        f"{progress.port:7} {progress.elapsed_s:7.1f} s  {counters.packets:,} packets "
        f"{progress.packets_per_s:.1f}/s{load}  {lost}  skipped {counters.bytes_skipped:,} B"
    )


def _rows(summary: "LiveSummary", progress: "Progress", views: _Views) -> dict[str, str]:
    from imumon.run.account import describe_disk, describe_span
    from imumon.run.narration import describe

    rows = {
        "recorded": describe_span(summary.began_ns, summary.ended_ns),
        **describe(progress),
        "outages": summary.outages.describe(),
        "on disk": describe_disk(summary.session),
    }
    if summary.wire.bytes_unrecorded:
        rows["NOT RECORDED"] = f"{summary.wire.bytes_unrecorded:,} bytes: {summary.recording_problem}"
    for output in views.outputs:
        rows |= output.rows
    if views.dropped:
        rows["view"] = f"{views.dropped:,} items were not shown; the recording has them"
    rows["session"] = str(summary.session)
    rows["replay"] = f"imumon replay {shlex.quote(str(summary.session))} --view {common.chosen_view(None)}"
    return rows
