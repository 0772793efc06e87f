"""The option `--publish` of `imumon monitor`: live samples for other programs."""

from collections.abc import Sequence
from typing import TYPE_CHECKING

import click

from imumon.cli.common import warn

if TYPE_CHECKING:
    from imumon.view.items import ViewSetup

    from .publisher import Publishers
    from .target import Target

name = "publish"
option = click.option(
    "--publish",
    multiple=True,
    metavar="KIND[=HOST:PORT]",
    help="Send the samples, too: udp-json, foxglove or ros2; without an address to this computer alone.",
)


def parse(given: Sequence[str]) -> "list[Target]":
    """Return the targets of --publish; report those beyond this computer."""
    from .target import parse_target

    targets = [parse_target(text) for text in given]
    warn(target.warning for target in targets if target.warning is not None)
    return targets


def start(parsed: "Sequence[Target]", setup: "ViewSetup") -> "Publishers":
    """Begin to send to them."""
    from .publisher import Publisher, Publishers

    return Publishers([Publisher(target, setup).start() for target in parsed])
