"""``imumon plugins``: what other packages add."""

from __future__ import annotations

from dataclasses import asdict
from typing import TYPE_CHECKING

import click

from imumon.cli.common import json_option, print_json, show
from imumon.errors import EXIT_NEGATIVE, EXIT_OK

if TYPE_CHECKING:
    from imumon.run.plugins import Installed


@click.command("plugins")
@json_option
def command(as_json: bool) -> int:
    """List the plug-ins with their packages, what each brings, and whether it loads.

    \b
    imumon plugins

    Exits with 1 when one does not load.
    """
    from imumon.run.plugins import installed

    found = installed()
    if as_json:
        print_json({"plugins": [asdict(plugin) for plugin in found]})
    else:
        for plugin in found:
            show(f"{plugin.name:<14} {plugin.group} of {plugin.package} {plugin.version}".rstrip())
            show(f"{'':<14} {_state(plugin)}")
        if not found:
            show("no plug-ins")
    return EXIT_NEGATIVE if any(plugin.problem for plugin in found) else EXIT_OK


def _state(plugin: Installed) -> str:
    if plugin.problem:
        return f"does NOT load: {plugin.problem}"
    return f"loads; brings {', '.join(plugin.brings) or 'nothing'}"
