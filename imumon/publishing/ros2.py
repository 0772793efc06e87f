"""Topics of ROS 2, by rclpy: the messages that ``export --to mcap`` writes, under the same names."""

import importlib
import os
from collections.abc import Sequence
from typing import Any

from imumon.errors import bad_config
from imumon.protocols.base import MAIN
from imumon.recordings.ros2 import Message, Stream
from imumon.view.items import Samples, ViewSetup

from .publisher import CLOCKS, Published
from .target import Target

ALONE = {"ROS_LOCALHOST_ONLY": "1", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
"""Keeps ROS on this computer: the first up to Humble, the second since."""
DEPTH = 1000
"""Messages that are kept for a reliable reader: a second of samples at 1 kHz."""


class Ros2:
    """A node with a publisher for each topic; states and log lines have no message of their own.

    Publishers are reliable, as those who ask for less get their messages too.

    Raises BAD_CONFIG when ROS cannot be started.
    """

    def __init__(self, target: Target, setup: ViewSetup) -> None:
        if target.is_local:
            os.environ.update(ALONE)
        try:
            # ROS brings these; no type checker knows them where there is no ROS.
            self._ros = importlib.import_module("rclpy")
            self._fill = importlib.import_module("rosidl_runtime_py").set_message_fields
            self._find = importlib.import_module("rosidl_runtime_py.utilities").get_message
            self._ros.init()
            self._node = self._ros.create_node("imumon")
        except (ImportError, RuntimeError) as error:
            raise bad_config(f"ROS 2 cannot be started: {error}") from error
        self._setup = setup
        self._streams: dict[str, Stream] = {}
        self._publishers: dict[str, tuple[Any, Any]] = {}
        self.text = "node imumon"

    def send(self, items: Sequence[Published]) -> int:
        """Publish the samples; return how many messages ROS did not take."""
        failed = 0
        for item in items:
            if isinstance(item, Samples):
                name = item.stream or MAIN
                if (stream := self._streams.get(name)) is None:
                    clock = next((one for one in CLOCKS if one in item.block), "")
                    stream = Stream(name, self._setup.units, clock, self._setup.z_down)
                    self._streams[name] = stream
                stream.learn(item.block)
                for topic, kind, _, message in stream.messages(item.block):
                    failed += not self._publish(topic, kind, message)
        return failed

    def close(self) -> None:
        """End the node."""
        self._node.destroy_node()
        self._ros.shutdown()

    def _publish(self, topic: str, kind: str, values: Message) -> bool:
        if topic not in self._publishers:
            made = self._find(kind)
            self._publishers[topic] = made, self._node.create_publisher(made, topic, DEPTH)
        made, publisher = self._publishers[topic]
        message = made()
        self._fill(message, _as_ros(values))
        try:
            publisher.publish(message)
        except RuntimeError as error:
            self.text = str(error)
            return False
        return True


def _as_ros(value: Any, name: str = "") -> Any:
    """Return a field as Python has it in ROS, where a byte is of type bytes."""
    if isinstance(value, dict):
        return {key: _as_ros(one, key) for key, one in value.items()}
    if isinstance(value, list) and value and isinstance(value[0], dict):
        return [_as_ros(one) for one in value]
    return bytes([value]) if name == "level" else value
