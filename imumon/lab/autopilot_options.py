"""Options of `calibrate` that write the model in the parameters of an autopilot."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, TypedDict, TypeVar

import click

from imumon.cli.common import Whole, warn

if TYPE_CHECKING:
    from imumon.models.model import BiasModel

Command = TypeVar("Command", bound=Callable[..., Any])


class AutopilotOptions(TypedDict):
    """The values of the options; None where one was not given."""

    autopilot: Literal["ardupilot", "px4"] | None
    imu: int
    device_ids: tuple[int, int] | None


def autopilot_options(command: Command) -> Command:
    """Add the options; the command gets them as keywords named as in `AutopilotOptions`."""
    for option in (
        click.option(
            "--device-ids", nargs=2, type=int, metavar="GYRO ACCEL", help="PX4's identifiers of the sensors."
        ),
        click.option("--imu", type=Whole(0, 3), default=0, help="Number of the autopilot's sensor, from 0."),
        click.option(
            "--export",
            "autopilot",
            type=click.Choice(["ardupilot", "px4"]),
            help="Also write the model in the parameters of an autopilot, beside --out.",
        ),
    ):
        command = option(command)
    return command


def check_parameters(out: Path, options: AutopilotOptions) -> Path | None:
    """Return where the parameters go, None where none were asked for; raise before any work what is wrong.

    Raises EXISTS when there is such a file; BAD_CONFIG when identifiers are missing.
    """
    if options["autopilot"] is None:
        return None
    from imumon.files import check_output
    from imumon.lab.calibration.autopilot import SUFFIX, check_ids

    check_ids(options["autopilot"], options["device_ids"])
    path = out.with_suffix(SUFFIX[options["autopilot"]])
    check_output(path)
    return path


def write_parameters(model: BiasModel, path: Path | None, options: AutopilotOptions) -> dict[str, Path]:
    """Write the parameters there, and say what to know of them; return what was written.

    Raises ImumonError as `imumon.lab.calibration.autopilot.parameters`.
    """
    if path is None or options["autopilot"] is None:
        return {}
    from imumon.files import write_text
    from imumon.lab.calibration.autopilot import parameters

    made = parameters(model, options["autopilot"], options["imu"], options["device_ids"])
    write_text(path, made.text)
    warn(made.notes)
    return {"parameters": path}
