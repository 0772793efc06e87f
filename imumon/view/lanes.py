"""The lanes of states: their order, their names, their colours."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import rerun as rr

from imumon.lane import Level

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

LAST = 9
"""The viewer sorts by name: from here on the names themselves decide."""

COLORS = {Level.GOOD: 0x2E9E5BFF, Level.WAIT: 0xE0A020FF, Level.BAD: 0xD64545FF, Level.PLAIN: 0x6C7A92FF}
"""0xRRGGBBAA."""

COLORED_STATES = 40
"""States of a lane that get a colour of ours; the viewer colours any others itself."""


def lane_path(lane: str) -> str:
    """Return the entity of a lane; lanes stand in the order of these, and the viewer shows no other name."""
    names = list(NAMES)
    place = min(names.index(lane) + 1 if lane in names else LAST, LAST)
    return f"/{place}-{NAMES.get(lane, lane).replace(' ', '-')}"


def declare_lane(rec: rr.RecordingStream, lane: str, states: Mapping[str, Level]) -> None:
    """Log the colours of the states that a lane has had."""
    colors, texts = np.array([COLORS[level] for level in states.values()], np.uint32), list(states)
    rec.log(lane_path(lane), rr.StateConfiguration(values=texts, labels=texts, colors=colors), static=True)


def states_text(states: Mapping[str, str]) -> str:
    """Return the state of every lane, in the order and under the names that a person knows."""
    order = {name: at for at, name in enumerate(NAMES)}
    lanes = sorted(states.items(), key=lambda item: order.get(item[0], len(order)))
    return "  ".join(f"{NAMES.get(lane, lane)} {state}" for lane, state in lanes)
