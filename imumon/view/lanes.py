"""The lanes of states: their order, their names, their colours."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import rerun as rr

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

GOOD, WAIT, BAD, PLAIN = 0x2E9E5BFF, 0xE0A020FF, 0xD64545FF, 0x6C7A92FF
_WORDS = {
    GOOD: "open ok good synchronised connected running recording rest valid settled",
    WAIT: "opening waiting silent starting reconnecting warning acquiring aligning better",
    BAD: "lost closed error failed bad jumped invalid clipping suspect disturbed hangs dead",
    PLAIN: "not",
}
STATE_COLORS = {word: color for color, words in _WORDS.items() for word in words.split()}
"""Colour of a state by the first of its words, in lower case, that is here; else it is grey-blue."""

COLORED_STATES = 40
"""States of a lane that get a colour of ours; the viewer colours any others itself."""


def state_color(state: str) -> int:
    """Return the colour of a state as 0xRRGGBBAA: that of the first of its words that has one."""
    words = [word.rstrip(":,") for word in state.lower().split(":")[0].split()]
    return next((STATE_COLORS[word] for word in words if word in STATE_COLORS), PLAIN)


def lane_path(lane: str) -> str:
    """Return the entity of a lane; lanes stand in the order of these, and the viewer shows no other name."""
    names = list(NAMES)
    place = min(names.index(lane) + 1 if lane in names else LAST, LAST)
    return f"/{place}-{NAMES.get(lane, lane).replace(' ', '-')}"


def declare_lane(rec: rr.RecordingStream, lane: str, states: list[str]) -> None:
    """Log the colours of the states that a lane has had."""
    colors = np.array([state_color(state) for state in states], dtype=np.uint32)
    rec.log(lane_path(lane), rr.StateConfiguration(values=states, labels=states, colors=colors), static=True)


def states_text(states: Mapping[str, str]) -> str:
    """Return the state of every lane, in the order and under the names that a person knows."""
    order = {name: at for at, name in enumerate(NAMES)}
    lanes = sorted(states.items(), key=lambda item: order.get(item[0], len(order)))
    return "  ".join(f"{NAMES.get(lane, lane)} {state}" for lane, state in lanes)
