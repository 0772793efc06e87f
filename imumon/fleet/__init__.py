"""Wing: many units at once, many sessions, and what became of each unit."""

from imumon.wing import Command, Wing

_GROUP = "Many units"
WING = Wing(
    "fleet",
    commands={
        "rack": Command(_GROUP, "Record and watch many devices at once.", "imumon.fleet.rack_command"),
        "batch": Command(
            _GROUP, "Run a command over many sessions, here or on a cluster.", "imumon.fleet.batch_command"
        ),
        "catalog": Command(
            _GROUP,
            "List the units of a folder of sessions, with what changed.",
            "imumon.fleet.catalog_command",
        ),
        "report": Command(
            _GROUP,
            "Write the calibration record of a session or a unit as a page.",
            "imumon.fleet.report_command",
        ),
    },
)
