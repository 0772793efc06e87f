"""Wing: what makes and questions bias models: calibration, diagnosis, plans of experiments."""

from imumon.wing import Command, Wing

_GROUP = "Understand a unit"
_ROOM = "imumon.lab"
WING = Wing(
    "lab",
    commands={
        "calibrate": Command(
            _GROUP, "Find the bias over temperature from recordings at rest.", f"{_ROOM}.calibrate_command"
        ),
        "magnetometer": Command(
            _GROUP, "Find hard and soft iron from a figure-eight.", f"{_ROOM}.magnetometer_command"
        ),
        "diagnose": Command(_GROUP, "Name the effect that a bias model lacks.", f"{_ROOM}.diagnose_command"),
        "learn": Command(
            _GROUP, "Make a better bias model from all sessions of a unit.", f"{_ROOM}.learn_command"
        ),
        "plan": Command(
            _GROUP,
            "Find the experiment that settles what a diagnosis leaves open.",
            f"{_ROOM}.plan_command",
        ),
    },
    stages="imumon.lab.hooks:better_model",
    compare_models="imumon.lab.hooks:compare_models",
)
