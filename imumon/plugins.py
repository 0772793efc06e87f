"""What other packages add to imumon: entry points, by their group."""

import os
from collections.abc import Callable
from functools import cache
from importlib.metadata import EntryPoint, entry_points
from traceback import extract_tb
from typing import Any, NamedTuple

from .errors import ImumonError, bad_config

STAGES = "imumon.stages"
"""Callables without arguments that return a stage (`imumon.stage.Estimator`)."""
DEVICES = "imumon.devices"
"""Folders of device files."""
EFFECTS = "imumon.effects"
"""Effects (`imumon.effects.base.Effect`), under the name that they have."""
WINGS = "imumon.wings"
"""Wings (`imumon.wing.Wing`), under their names."""
WITHOUT = "IMUMON_WITHOUT_PLUGINS"
"""Environment variable of ``imumon --without-plugins``: no plug-in is loaded, in child processes neither."""
FRAMES = 8
"""Calls of a traceback that are reported, the innermost ones: a line of the log is limited."""


class Plugin(NamedTuple):
    """What an installed package offers in a group under a name."""

    group: str
    name: str
    package: str
    version: str
    offered: Any = None

    def error(self, what: str) -> ImumonError:
        """Return the error that states what is wrong with it."""
        return bad_config(
            f"the plug-in {self.name} of {self.package} ({self.group}) {what}",
            f"mend it, run with imumon --without-plugins, or remove it: pip uninstall {self.package}",
        )


def package_of(entry: EntryPoint) -> tuple[str, str]:
    """Return name and version of the package that an entry point is of."""
    return (entry.dist.name, entry.dist.version) if entry.dist is not None else ("an unknown package", "")


def entries(group: str) -> list[EntryPoint]:
    """Return the entry points of a group by name; none with ``--without-plugins``."""
    return [] if os.environ.get(WITHOUT) else sorted(entry_points(group=group), key=lambda entry: entry.name)


def load(entry: EntryPoint, needed: str, fits: Callable[[str, Any], bool]) -> Plugin:
    """Return what an entry point offers.

    Raises BAD_CONFIG when it cannot be imported or is something else.

    `needed` names what is offered in its group; `fits` tests a name and what is offered under it.
    """
    plugin = Plugin(entry.group, entry.name, *package_of(entry))
    try:
        plugin = plugin._replace(offered=entry.load())
    except Exception as error:
        raise plugin.error(f"cannot be imported: {type(error).__name__}: {error}") from error
    if not fits(plugin.name, plugin.offered):
        raise plugin.error(f"is no {needed}: {plugin.offered!r}")
    return plugin


@cache
def plugins(group: str, needed: str, fits: Callable[[str, Any], bool]) -> tuple[Plugin, ...]:
    """Return what installed packages offer in a group, by name.

    Raises BAD_CONFIG as `load`, and when two have the same name.
    """
    found: dict[str, Plugin] = {}
    for entry in entries(group):
        plugin = load(entry, needed, fits)
        if entry.name in found:
            raise plugin.error(f"has the name of one of {found[entry.name].package}")
        found[entry.name] = plugin
    return tuple(found.values())


def described(error: Exception, caller: str) -> str:
    """Return what somebody else's code raised, with its traceback in one line, the innermost call first.

    `caller` is the file of imumon that called the code; it is left out of the traceback.
    """
    if isinstance(error, ImumonError):
        return error.seen
    what = f"{type(error).__name__}: {error}"
    frames = [frame for frame in extract_tb(error.__traceback__) if frame.filename != caller]
    calls = [f"{frame.filename}:{frame.lineno} in {frame.name}" for frame in frames[: -FRAMES - 1 : -1]]
    return f"{what} (at {', called at '.join(calls)})" if calls else what
