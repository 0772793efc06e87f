"""Wing: settings of a device, read, tried and written; and virtual devices that answer the commands."""

from imumon.wing import Command, Wing

WING = Wing(
    "configure",
    commands={
        "configure": Command(
            "Devices", "Set rate, outputs and baud rate of a device.", "imumon.configure.configure_command"
        )
    },
    firmware={
        "xsens-mtdata2": "imumon.configure.xsens:XsensFirmware",
        "mip": "imumon.configure.mip:MipFirmware",
        "vectornav": "imumon.configure.vectornav:VectorNavFirmware",
        "witmotion": "imumon.configure.witmotion:WitMotionFirmware",
    },
)
