"""The command line: one file per command, imported only when that command runs."""

from __future__ import annotations

import sys
from importlib import import_module

import click

from imumon.errors import EXIT_OK, ImumonError

COMMANDS = {
    "monitor": "Record a device and watch it live.",
    "replay": "Run a recording again: same code, same numbers.",
    "decode": "Turn a raw capture or a session into a table.",
    "import": "Make a session from a CSV or Parquet table.",
    "export": "Write the samples of a session as a table.",
    "ports": "List serial ports.",
    "detect": "Find baud rate and protocol of a device by trying.",
    "devices": "List the devices that imumon knows.",
    "virtual": "Be a device: a simulated AHRS on a pseudo-terminal.",
}
"""Commands in the order of the help, with the line that it shows; NAME is in imumon.cli.NAME_command."""


class _LazyGroup(click.Group):
    """Knows the names of its commands without importing them: the help must not wait for numpy."""

    def list_commands(self, ctx: click.Context) -> list[str]:  # noqa: ARG002 - click's signature
        return list(COMMANDS)

    def get_command(self, ctx: click.Context, cmd_name: str) -> click.Command | None:  # noqa: ARG002
        if cmd_name not in COMMANDS:
            return None
        command = import_module(f"imumon.cli.{cmd_name}_command").command
        assert isinstance(command, click.Command)
        return command

    def format_commands(self, ctx: click.Context, formatter: click.HelpFormatter) -> None:  # noqa: ARG002
        with formatter.section("Commands"):
            formatter.write_dl(list(COMMANDS.items()))


@click.group(
    cls=_LazyGroup,
    context_settings={"help_option_names": ["-h", "--help"], "max_content_width": 100},
    epilog="Exit codes: 0 done; 1 the answer is no; 2 wrong option or file; 3 port; 4 data.",
)
@click.version_option(package_name="imumon")
def cli() -> None:
    """Watch, record and understand an IMU or AHRS on the bench."""


def main() -> None:
    """Run the command line; errors that a user can act on end with one clear message and their exit code."""
    try:
        code = cli.main(standalone_mode=False)
    except ImumonError as error:
        click.echo(f"imumon: {error.reason.value}: {error.seen}", err=True)
        if error.hint:
            click.echo(error.hint, err=True)
        sys.exit(error.reason.exit_code)
    except click.ClickException as error:
        error.show()
        sys.exit(error.exit_code)
    except click.Abort:
        sys.exit(130)
    except BrokenPipeError:  # the reader of our output went away, as `head` does
        sys.stderr.close()
        sys.exit(EXIT_OK)
    sys.exit(code if isinstance(code, int) else EXIT_OK)
