"""Wing: logs of autopilots and robots, which describe their own content."""

from imumon.wing import Wing

WING = Wing("logs", import_log="imumon.logs.importing:import_log")
