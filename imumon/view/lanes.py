"""The lanes of states (their order, names and colours), and the newest log lines as a text."""

from collections.abc import Mapping
from contextlib import suppress
from datetime import datetime

import numpy as np
import rerun as rr

from imumon.harmless import for_markdown
from imumon.lane import Level

from .items import Log

NAMES = {
    "port": "Port",
    "link": "Link",
    "data": "Data",
    "clock": "Clock",
    "motion": "Motion",
    "model": "Bias-model",
    "alignment": "Alignment",
    "heading by": "Heading-by",
    "attitude": "Attitude",
    "status": "Device-status",
    "mark": "Mark",
    "part": "Part",
}
"""What a person calls the lanes, from above: first what everything else depends on."""

COLORS = {Level.GOOD: 0x2E9E5BFF, Level.WAIT: 0xE0A020FF, Level.BAD: 0xD64545FF, Level.PLAIN: 0x6C7A92FF}
"""0xRRGGBBAA."""

COLORED_STATES = 40
"""States of a lane that get a colour of ours; the viewer colours any others itself."""


def lane_place(lane: str) -> int:
    """Return the place of a lane, from 1; lanes of other packages' stages share the last one."""
    return [*NAMES, lane].index(lane) + 1


def lane_path(lane: str) -> str:
    """Return the entity of a lane; the viewer sorts by the number, and shows no other name."""
    return f"/{lane_place(lane)}-{NAMES.get(lane, lane).replace(' ', '-')}"


def declare_lane(rec: rr.RecordingStream, lane: str, states: Mapping[str, Level]) -> None:
    """Log the colours of the states that a lane has had."""
    colors = np.array([COLORS[level] for level in states.values()], np.uint32)
    rec.log(lane_path(lane), rr.StateConfiguration(values=list(states), colors=colors), static=True)


def states_text(states: Mapping[str, str]) -> str:
    """Return the state of every lane, in the order and under the names that a person knows."""
    return "  ".join(f"{NAMES.get(lane, lane)} {states[lane]}" for lane in sorted(states, key=lane_place))


LOG_TEXT = "/log_text"
"""Entity of the text; all lines are in the log of the session."""
LINES = 30
"""So many of the newest are shown."""


def markdown(line: Log) -> str:
    """Return a line with the time of the wall clock, and its level where that matters."""
    mark = "" if line.level == "INFO" else f"**{line.level}** "
    return f"`{clock(line.at.host_ns)}` {mark}{for_markdown(line.text)}"


def dated(line: Log) -> str:
    """Return a line as a terminal shows it: with the time of day, and its level where that matters."""
    mark = "" if line.level == "INFO" else f"{line.level} "
    return f"{clock(line.at.host_ns)} {mark}{line.text}"


def clock(host_ns: int | None) -> str:
    """Return the time of day where this program runs; dashes where it is not known or damaged."""
    if host_ns is not None:
        with suppress(OverflowError, OSError, ValueError):  # a damaged time
            return datetime.fromtimestamp(host_ns * 1e-9).astimezone().strftime("%H:%M:%S")
    return "--:--:--"
