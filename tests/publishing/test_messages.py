from __future__ import annotations

import numpy as np

from imumon.blocks import NO_INT, SampleBlock
from imumon.publishing.publisher import messages
from imumon.view.items import Instant, Log, Samples, State, Times

NOW = Instant(None, None, 70)


def test_a_row_is_a_message_without_what_is_not_there() -> None:
    block = SampleBlock(
        {
            "host_time_ns": np.array([10, NO_INT, NO_INT]),
            "arrival_time_ns": np.array([11, 12, NO_INT]),
            "gyro_x": np.array([0.1, np.nan, np.inf]),
            "gyro_bias_x": np.full(3, np.nan),
        }
    )
    assert [*messages([Samples(Times(np.arange(5, 5 + len(block)), None, None), block)], {})] == [
        ("imu", 10, {"sample": 5, "host_time_ns": 10, "arrival_time_ns": 11, "gyro_x": 0.1}),
        ("imu", 12, {"sample": 6, "arrival_time_ns": 12}),
        ("imu", None, {"sample": 7}),
    ]


def test_a_side_stream_has_a_topic_of_its_own() -> None:
    item = Samples(Times(None, None, None), SampleBlock({"arrival_time_ns": np.array([3])}), "gnss")
    assert [*messages([item], {})] == [("gnss", 3, {"arrival_time_ns": 3})]


def test_every_state_message_has_all_states() -> None:
    states = dict[str, float | int | str]()
    items = [State(NOW, "port", "open"), State(NOW, "data", "ok"), State(NOW, "port", "lost")]
    *_, third, log = messages([*items, Log(NOW, "gone", "WARN")], states)
    assert log == ("log", 70, {"level": "WARN", "text": "gone"})
    assert third == ("state", 70, {"port": "lost", "data": "ok"})
    assert states == third[2]
