"""Wing: logs of autopilots and robots, which say themselves what they hold."""

from imumon.wing import Wing

WING = Wing("logs", import_log="imumon.logs.importing:import_log")
