"""Wing: Allan, modified Allan and Hadamard deviations of an IMU, and the noise terms behind them."""

from imumon.wing import Command, Wing

WING = Wing(
    "allan",
    commands={
        "allan": Command(
            "Understand a unit",
            "Find noise, bias instability and drift of a recording at rest.",
            "imumon.allan.allan_command",
        )
    },
    stages="imumon.allan.live:allan_stage",
)
