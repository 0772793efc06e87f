"""Options of the commands that run the estimators, and the setup that they make."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING, Any, TypeVar

import click

from imumon.cli.common import PATH, Number
from imumon.run.paper_names import PUBLISHED

if TYPE_CHECKING:
    from imumon.run.setup import Setup

Command = TypeVar("Command", bound=Callable[..., Any])


_OPTIONS = (
    click.option(
        "--pipeline",
        type=PATH,
        help="Pipeline file (YAML): place, bias model and parameters of the estimators.",
    ),
    click.option(
        "--model", type=PATH, help="Model of the bias over temperature, a file of imumon calibrate."
    ),
    click.option(
        "--zupt",
        type=click.Choice(["standard", "thermal", "learned"]),
        help="How the gyro bias is carried through motion after it was measured at rest (zero-velocity"
        " update, ZUPT): held constant (standard without --model), along the curve of --model (thermal),"
        " or along a curve that is learned in this run (learned).  Default: thermal with --model, else"
        " learned.",
    ),
    click.option("--random-error", type=click.Choice(["drift", "sr_rsukf"]), hidden=True),
    click.option(
        "--published",
        metavar="NAME,...",
        help="Run methods from papers beside imumon's own, to compare them; the results are unchanged,"
        " columns are added.  Any of: " + ", ".join(PUBLISHED) + ".",
    ),
    click.option(
        "--latitude",
        type=Number(min=-90, max=90),
        help="Latitude of the place, degrees north; needed to remove the earth's rotation.",
    ),
    click.option(
        "--heading",
        type=Number(min=-360, max=360),
        help="Direction of the x axis, degrees clockwise from true north, where it is known.",
    ),
)


def setup_options(command: Command) -> Command:
    """Add the options; the command gets them as keywords named as they are."""
    for option in reversed(_OPTIONS):
        command = option(command)
    return command


def make_setup(given: Mapping[str, Any], recorded: str | None = None, source: str = "") -> Setup:
    """Return the setup of a run: the pipeline file, else that of the recording, changed by the options.

    Raises BAD_CONFIG when a file cannot be read, or the parts contradict each other.
    """
    from imumon.run.setup import Setup, load_setup, parse_setup

    setup = Setup()
    if (path := given.get("pipeline")) is not None:
        setup = load_setup(path)
    elif recorded is not None:
        setup = parse_setup(recorded, source)
    model = random_error = published = None
    if (path := given.get("model")) is not None:
        from imumon.models.model import load_model

        model = load_model(path)
    if (method := given.get("random_error")) is not None:
        random_error = setup.random_error.model_copy(update={"method": method})
    if (names := given.get("published")) is not None:
        published = [name for name in map(str.strip, names.split(",")) if name]
        if wrong := [name for name in published if name not in PUBLISHED or published.count(name) > 1]:
            expected = f"{wrong[0]}: expected {', '.join(PUBLISHED)}, each once"
            raise click.BadParameter(expected, param_hint="--published")
    return setup.with_options(
        model=model,
        zupt_mode=given.get("zupt"),
        random_error=random_error,
        published=published,
        latitude_deg=given.get("latitude"),
        heading_deg=given.get("heading"),
    )
