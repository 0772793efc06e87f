"""Wing: many units at once, many sessions, and what became of each unit."""

from imumon.wing import Command, Wing

_TEXTS = {
    "rack": "Record and watch many devices at once.",
    "batch": "Run a command over many sessions, here or on a cluster.",
    "catalog": "List the units of a folder of sessions, with what changed.",
    "report": "Write the calibration record of a session or a unit as a page.",
}
WING = Wing(
    "fleet",
    commands={
        name: Command("Many units", text, f"imumon.fleet.{name}_command") for name, text in _TEXTS.items()
    },
)
