"""Wing: many units at once, many sessions, and what became of each unit."""

from imumon.wing import Command, Wing

_LINES = {
    "rack": ("rack_command", "Record and watch many devices at once."),
    "batch": ("batch_command", "Run a command over many sessions, here or on a cluster."),
    "catalog": ("catalog_command:catalog", "List the units of a folder of sessions, with what changed."),
    "report": ("catalog_command:report", "Write the calibration record of a session or a unit as a page."),
}
WING = Wing(
    "fleet",
    commands={
        name: Command("Many units", text, f"imumon.fleet.{place}") for name, (place, text) in _LINES.items()
    },
)
