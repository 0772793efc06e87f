"""Wing: live samples for other programs: JSON over UDP, Foxglove, ROS 2."""

from imumon.wing import Wing

WING = Wing("publishing", live_output="imumon.publishing.options")
