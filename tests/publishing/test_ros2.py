"""Topics of ROS 2.  rclpy comes with ROS alone: its part is played by what notes the calls."""

from __future__ import annotations

import importlib
import os
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from imumon.blocks import SampleBlock
from imumon.errors import ImumonError
from imumon.publishing.ros2 import ALONE, Ros2
from imumon.publishing.target import Target
from imumon.view.items import Samples, State, Timebase, Times, ViewSetup
from tests.view.streams import block

UNITS = {"mag_x": "uT"}


class Ros:
    """What rclpy and rosidl_runtime_py offer, as far as it is used."""

    def __init__(self) -> None:
        self.published: dict[str, list[dict[str, Any]]] = {}
        self.kinds: dict[str, str] = {}
        self.ended = False

    def module(self, name: str) -> Any:
        if name == "rosidl_runtime_py.utilities":
            return SimpleNamespace(get_message=lambda kind: lambda: {"of": kind})
        if name == "rosidl_runtime_py":
            return SimpleNamespace(set_message_fields=lambda message, values: message.update(values))
        assert name == "rclpy"
        node = SimpleNamespace(create_publisher=self._publisher, destroy_node=lambda: None)
        return SimpleNamespace(init=lambda: None, create_node=lambda _: node, shutdown=self._end)

    def _publisher(self, made: Any, topic: str, _: int) -> Any:
        self.kinds[topic] = made()["of"]
        return SimpleNamespace(publish=self.published.setdefault(topic, []).append)

    def _end(self) -> None:
        self.ended = True


@pytest.fixture
def ros(monkeypatch: pytest.MonkeyPatch) -> Ros:
    made = Ros()
    monkeypatch.setattr(importlib, "import_module", made.module)
    for name in ALONE:
        monkeypatch.delenv(name, raising=False)
    return made


def sent(ros: Ros, z_down: bool = False, seconds: int = 3) -> Ros:
    """Publish samples at rest at 100 Hz in pieces of 80 ms, with bias and sigma."""
    outlet = Ros2(Target("ros2"), ViewSetup("bench", "bench", UNITS, z_down=z_down))
    timebase = Timebase()
    for first in range(0, 100 * seconds, 8):
        columns = {**block(first, 8).columns, "at_rest": np.ones(8, np.int64)}
        columns |= {f"gyro_bias_{axis}": np.full(8, 0.25) for axis in "xyz"}
        columns |= {f"gyro_bias_sd_{axis}": np.full(8, 0.01) for axis in "xyz"}
        assert outlet.send([timebase.samples(SampleBlock(columns))]) == 0
    outlet.close()
    return ros


def test_the_topics_are_those_of_a_bag_with_the_bias_taken_off(ros: Ros) -> None:
    sent(ros)
    assert ros.kinds["/imu/data"] == ros.kinds["/imu/data_raw"] == "sensor_msgs/msg/Imu"
    raw, data = ros.published["/imu/data_raw"], ros.published["/imu/data"]
    assert len(raw) == len(data) == 304
    rate, corrected = (one[100]["angular_velocity"]["x"] for one in (raw, data))
    assert rate == block(96, 8)["gyro_x"][4]
    assert corrected == rate - 0.25
    assert raw[100]["header"]["frame_id"] == "imu_link"
    white, whole = (one[-1]["angular_velocity_covariance"][0] for one in (raw, data))
    assert whole == pytest.approx(white + 0.01**2)
    assert len(ros.published["/diagnostics"]) == 4, "once a second, however the samples are cut"
    (status,) = ros.published["/diagnostics"][0]["status"]
    assert status["level"] == b"\x00", "a byte of ROS"
    assert ros.ended


def test_readings_are_recognised_when_they_change_however_the_samples_are_cut(ros: Ros) -> None:
    sent(ros)
    told = [one["temperature"] for one in ros.published["/imu/temperature"]]
    assert told == [value for first in range(0, 300, 8) for value in block(first, 8)["temperature"]]


def test_a_unit_with_z_down_is_turned(ros: Ros) -> None:
    raw = sent(ros, z_down=True).published["/imu/data_raw"][0]["linear_acceleration"]
    first = block(0, 8)
    assert [raw[axis] for axis in "xyz"] == [first["accel_x"][0], -first["accel_y"][0], -first["accel_z"][0]]


def test_ros_stays_on_this_computer_unless_requested(ros: Ros) -> None:
    setup = ViewSetup("bench", "bench")
    Ros2(Target("ros2", "network"), setup)
    assert not ALONE.keys() & os.environ.keys()
    outlet = Ros2(Target("ros2"), setup)
    assert {name: os.environ.pop(name) for name in ALONE} == ALONE
    assert outlet.send([State(Timebase().at(1), "port", "open")]) == 0
    assert not ros.published
    untimed = SampleBlock({"gyro_x": np.zeros(1)})
    assert outlet.send([Samples(Times(np.zeros(1, np.int64), None, None), untimed)]) == 0


def test_without_ros_it_reports_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib, "import_module", _missing)
    with pytest.raises(ImumonError, match="ROS 2 cannot be started: no rclpy"):
        Ros2(Target("ros2", "network"), ViewSetup("bench", "bench"))


def _missing(name: str) -> None:
    raise ImportError(f"no {name}")
