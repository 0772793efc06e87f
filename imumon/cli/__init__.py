"""The command line: commands are imported only when they run."""

import atexit
import errno
import gc
import logging
import os
import signal
import sys
import threading
from contextlib import suppress
from functools import cache, partial
from io import TextIOWrapper
from pkgutil import resolve_name
from typing import TYPE_CHECKING

import click
from click.exceptions import Exit
from click.shell_completion import shell_complete

from imumon.errors import EXIT_INTERRUPTED, EXIT_OK, EXIT_USAGE, ImumonError
from imumon.view import RECORDER
from imumon.wing import GROUPS, Command, built_in, wings

from .common import INTERRUPTED, log, note

if TYPE_CHECKING:
    from sys import UnraisableHookArgs
    from types import FrameType

COMPLETION = "_IMUMON_COMPLETE"
"""What a shell sets to query what may come next."""

NEW_OBJECTS = 10_000
"""So many new objects between two searches for garbage, not Python's 700: what is loaded stays, and to search
through it again and again took a tenth of the time that a recording needs to begin."""

OWN = {
    "Watch and record": {
        "monitor": ("monitor_command:command", "Record a device and watch it live."),
        "replay": ("replay_commands:replay", "Run a recording again, bit for bit."),
        "view": ("replay_commands:view", "Show several sessions on one time axis."),
        "mark": ("table_commands:mark", "Put a word into a recording while it runs."),
        "recover": ("table_commands:recover", "Finish a session that was interrupted or damaged."),
    },
    "Data in and out": {
        "decode": ("table_commands:decode", "Turn a raw capture or a session into a table."),
        "import": ("table_commands:import_", "Make a session from a CSV or Parquet table, or from a log."),
        "export": ("table_commands:export", "Write the samples of a session as a table."),
    },
    "Understand a unit": {
        "align": ("align_command:command", "Find the heading of a resting unit by the earth rate."),
    },
    "Devices": {
        "doctor": ("computer_commands:doctor", "Check what this computer lacks."),
        "ports": ("computer_commands:ports", "List serial ports."),
        "detect": ("computer_commands:detect", "Find device and baud rate of a port."),
        "devices": ("computer_commands:devices", "List the devices that imumon knows."),
        "plugins": ("computer_commands:plugins", "List what other packages add, and whether it loads."),
    },
}
"""Commands of the core by group: where each is in `imumon.cli`, and the line that the help shows."""

START = ("demo", "doctor", "detect PORT", "monitor PORT --device NAME", "replay sessions/NAME")
"""What a beginner needs, as `imumon` without arguments shows it."""


@cache
def commands(of_plugins: bool = False) -> dict[str, Command]:
    """Return the commands by their names, in the order of the help; of each group first those of the core.

    Raises BAD_CONFIG when a wing of another package does not load; those are looked for only where requested.
    """
    found = {
        name: Command(group, text, f"imumon.cli.{place}")
        for group, lines in OWN.items()
        for name, (place, text) in lines.items()
    }
    for wing in wings() if of_plugins else built_in():
        found |= {name: command for name, command in wing.commands.items() if name not in found}
    return dict(sorted(found.items(), key=lambda item: GROUPS.index(item[1].group)))


class _LazyGroup(click.Group):
    """Knows the names of its commands without importing them: the help must not wait for numpy."""

    def list_commands(self, ctx: click.Context) -> list[str]:
        return [name for lines in _listed(ctx).values() for name in lines]

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:
        if ctx.params.get("without_plugins"):  # before the command is imported, which may query the wings
            from imumon.plugins import WITHOUT  # not for --help: it loads importlib.metadata

            os.environ[WITHOUT] = "1"
            ctx.call_on_close(partial(os.environ.pop, WITHOUT, None))
        found = commands().get(cmd_name) or commands(of_plugins=True).get(cmd_name)
        if found is None:
            self.commands = {name: click.Command(name) for name in self.list_commands(ctx)}  # to suggest one
            return None
        command = resolve_name(found.module if ":" in found.module else f"{found.module}:command")
        assert isinstance(command, click.Command)
        return command

    def parse_args(self, ctx: click.Context, args: list[str]) -> list[str]:
        if not args and not ctx.resilient_parsing:
            click.echo(_short_help(ctx))
            ctx.exit()
        return super().parse_args(ctx, args)

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:
        for group, lines in _listed(ctx).items():
            with formatter.section(group):
                formatter.write_dl([*lines.items()])


def _short_help(ctx: click.Context) -> str:
    """Return what a beginner needs to see first: five commands, the names of all, and where more is."""
    formatter = ctx.make_formatter()
    formatter.write_text(str(cli.help))
    with formatter.section("Start here"):
        formatter.write_dl(
            [(f"imumon {usage}", commands()[usage.split()[0]].help) for usage in START], col_max=40
        )
    with formatter.section("All commands"):
        formatter.write_dl([(group, ", ".join(lines)) for group, lines in _listed(ctx).items()])
    formatter.write_paragraph()
    formatter.write_text("imumon --help has a line on each command, imumon COMMAND --help all about one.")
    return formatter.getvalue().rstrip("\n")


def _listed(ctx: click.Context) -> dict[str, dict[str, str]]:
    """Return help lines by group and command, without a wing that does not load: see `imumon plugins`."""
    try:
        known = commands(of_plugins=not ctx.params.get("without_plugins"))
    except ImumonError:
        known = commands()
    found: dict[str, dict[str, str]] = {}
    for name, command in known.items():
        found.setdefault(command.group, {})[name] = command.help
    return found


@click.group(
    cls=_LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Exit codes: 0 done; 1 done, but the result is negative; 2 wrong option or setting; 3 error"
    " of the port; 4 data that are missing or cannot be read.",
)
@click.version_option(package_name="imumon")
@click.option("--without-plugins", is_flag=True, help="Load nothing that other packages add.")
def cli(without_plugins: bool) -> None:
    """Watch, record and understand an IMU or AHRS on the bench."""


def main() -> None:
    """Run the command line; errors that a user can act on end with one clear message and their exit code."""
    # Read when NumPy is imported.  The matrices are small: threads that wait in a spin cost up to eight times
    # the work on a machine that has something else to do.
    os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")
    gc.set_threshold(NEW_OBJECTS)
    if instruction := os.environ.get(COMPLETION):
        sys.exit(shell_complete(cli, {}, "imumon", COMPLETION, instruction))
    _heed_interrupts()
    _open_missing_streams()
    if isinstance(sys.stdout, TextIOWrapper) and sys.stdout.errors == "strict":  # it may lack ° or τ
        sys.stdout.reconfigure(errors="backslashreplace")
    _report_compiling()
    code = run(sys.argv[1:])
    # All is done: Ctrl-C now only spares what Python does before it ends.
    signal.signal(signal.SIGINT, lambda *_: os._exit(code))
    _settle_streams()
    # Where Ctrl-C came in a call of exec, as dataclasses do, Python would end by the signal; where a view is
    # still being drawn, in C++, by an abort.
    if code == EXIT_INTERRUPTED or any(one.name == RECORDER for one in threading.enumerate()):
        os._exit(code)
    sys.exit(code)


def run(arguments: list[str]) -> int:
    """Run one command and return its exit code; errors are written on standard error."""
    try:
        # Not cli.main(), which ends with 1 by itself when the reader of our output went away, as `head` does.
        with cli.make_context("imumon", arguments) as context:
            code = cli.invoke(context)
        sys.stdout.flush()
    except Exit as error:  # --help and --version
        return error.exit_code
    except ImumonError as error:
        note(f"imumon: {error.reason.value}: {error.seen}")
        if error.hint:
            note(error.hint)
        return error.reason.exit_code
    except click.ClickException as error:
        with suppress(OSError):
            error.show()
        return error.exit_code
    except (click.Abort, KeyboardInterrupt):
        return EXIT_INTERRUPTED
    except BrokenPipeError:
        return EXIT_OK
    except OSError as error:
        where = f"{error.filename}: " if error.filename is not None else ""
        note(f"imumon: {where}{error.strerror or error}")
        if error.errno in (errno.ENOSPC, errno.EDQUOT):
            note("make room, or give a place on another disk")
        elif error.filename is not None:
            note("is it there, and may you read it and write to its folder?")
        return EXIT_USAGE
    except Exception:
        if INTERRUPTED.is_set():  # Python 3.11 and pydantic make other errors of Ctrl-C
            return EXIT_INTERRUPTED
        raise
    return code if isinstance(code, int) else EXIT_OK


def _interrupt(number: int, frame: "FrameType | None") -> None:
    INTERRUPTED.set()
    signal.default_int_handler(number, frame)


def _heed_interrupts() -> None:
    """Let Ctrl-C raise KeyboardInterrupt, also where Python would print it and go on.

    That is so in callbacks: of weak references (an import has many), of the garbage collector, of C code.  It
    is sent again when the callback is over.
    """
    if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
        return
    signal.signal(signal.SIGINT, _interrupt)
    # The first to be registered is the last to be called: from there on Python heeds no signal in order.
    atexit.register(signal.signal, signal.SIGINT, signal.SIG_IGN)
    usual = sys.unraisablehook

    def again(lost: "UnraisableHookArgs") -> None:
        if lost.exc_type is KeyboardInterrupt:
            threading.Timer(0.01, signal.raise_signal, [signal.SIGINT]).start()
        elif not INTERRUPTED.is_set():  # what was interrupted half made cannot be taken down in order
            usual(lost)

    sys.unraisablehook = again


def _open_missing_streams() -> None:
    """Let closed standard streams lead nowhere.

    Otherwise the next file that is opened, perhaps the recording, takes the number of standard error, and
    what a library writes there ends up in it.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            stream = open(os.devnull, mode, encoding="utf-8")  # noqa: PTH123, SIM115  (stays open; not a path)
            os.set_inheritable(stream.fileno(), True)
            setattr(sys, name, stream)


def _report_compiling() -> None:
    """Log what a command waits for; in the main thread only, as a stopped terminal blocks whoever writes."""

    def report(record: logging.LogRecord) -> bool:
        if threading.current_thread() is threading.main_thread():
            log(record.levelname, record.getMessage())
        return False  # it goes nowhere else

    compiling = logging.getLogger("imumon.compiled")
    compiling.setLevel(logging.INFO)
    compiling.addFilter(report)


def _settle_streams() -> None:
    """Drop what a closed pipe or a full disk did not take, or the interpreter would end with its own code."""
    for stream in (sys.stdout, sys.stderr):
        try:
            stream.flush()
        except OSError:
            nowhere = os.open(os.devnull, os.O_WRONLY)
            os.dup2(nowhere, stream.fileno())
            os.close(nowhere)
