"""Wing: what makes and questions bias models: calibration, diagnosis, plans of experiments."""

from imumon.wing import Command, Wing

_COMMANDS = {
    "calibrate": ("calibrate_commands:calibrate", "Find the bias over temperature from recordings at rest."),
    "magnetometer": ("calibrate_commands:magnetometer", "Find hard and soft iron from a figure-eight."),
    "diagnose": ("diagnosis_commands:diagnose", "Name the effect that a bias model lacks."),
    "learn": ("diagnosis_commands:learn", "Make a better bias model from all sessions of a unit."),
    "plan": ("diagnosis_commands:plan", "Find the experiment that settles what a diagnosis leaves open."),
}
WING = Wing(
    "lab",
    commands={
        name: Command("Understand a unit", text, f"imumon.lab.{place}")
        for name, (place, text) in _COMMANDS.items()
    },
    stages="imumon.lab.hooks:better_model",
    compare_models="imumon.lab.hooks:compare_models",
)
