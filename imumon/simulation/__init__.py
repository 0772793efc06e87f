"""Wing: simulated units, chambers and devices, for a first look, for tests and for plans."""

from imumon.wing import Command, Wing

_COMMANDS = {
    "demo": "Watch a simulated AHRS, without hardware.",
    "virtual": "Be a device: a simulated AHRS on a pseudo-terminal.",
    "simulate": "Make a session or a table, with true values.",
}
WING = Wing(
    "simulation",
    commands={
        name: Command("Without hardware", text, f"imumon.simulation.commands:{name}")
        for name, text in _COMMANDS.items()
    },
)
