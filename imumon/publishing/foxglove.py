"""A server that Foxglove opens, by its own SDK: a topic of JSON for each stream, for states and the log."""

import logging
from collections.abc import Sequence

import foxglove
from foxglove.channels import LogChannel
from foxglove.messages import Log as FoxgloveLog
from foxglove.messages import LogLevel, Timestamp

from imumon.columns import KNOWN, Column
from imumon.errors import ImumonError, Reason
from imumon.protocols.base import MAIN
from imumon.view.items import Samples, ViewSetup

from .publisher import LOG, STATE, Published, Value, messages
from .target import Target

LEVELS = {"DEBUG": LogLevel.Debug, "INFO": LogLevel.Info, "WARN": LogLevel.Warning, "ERROR": LogLevel.Error}
SECOND_NS = 1_000_000_000
FULL = "foxglove.websocket.connected_client.send_lossy"
"""Logger on which the SDK reports that a viewer does not take what is sent; it does not count."""


class Foxglove:
    """The server and its channels, made when the first message of each comes.

    Raises BUSY when the port cannot be had.
    """

    def __init__(self, target: Target, setup: ViewSetup) -> None:
        self._units, self._states = setup.units, dict[str, Value]()
        self._is_slow = False
        logging.getLogger(FULL).addFilter(self._note_slow)
        logging.getLogger(FULL).setLevel(logging.INFO)
        self._context = foxglove.Context()
        try:
            self._server = foxglove.start_server(
                name=f"imumon {setup.title}", host=target.host, port=target.port, context=self._context
            )
        except RuntimeError as error:
            raise ImumonError(Reason.BUSY, f"cannot serve {target}: {error}", "give another port") from error
        self._url = f"ws://{str(target).partition('=')[2]}"
        self._channels = {STATE: self._channel(STATE, set())}
        self._columns: dict[str, set[str]] = {}
        self._log = LogChannel("/log", context=self._context)

    @property
    def text(self) -> str:
        """The address, and whether a viewer is too slow."""
        return f"{self._url}, a viewer is too slow and misses messages" if self._is_slow else self._url

    def send(self, items: Sequence[Published]) -> int:
        """Hand messages to the SDK, which keeps the latest 1024 for a slow viewer; none fails here."""
        wanted = [item for item in items if not isinstance(item, Samples) or self._is_wanted(item)]
        for topic, time_ns, values in messages(wanted, self._states):
            if topic == LOG:
                level = LEVELS.get(str(values["level"]), LogLevel.Unknown)
                when, text = Timestamp(*divmod(time_ns or 0, SECOND_NS)), str(values["text"])
                line = FoxgloveLog(timestamp=when, level=level, message=text, name="imumon")
                self._log.log(line, log_time=time_ns)
            else:
                self._channels[topic].log(dict(values), log_time=time_ns)
        return 0

    def close(self) -> None:
        """End the server."""
        self._server.stop()

    def _note_slow(self, _: logging.LogRecord) -> bool:
        self._is_slow = True
        return False

    def _is_wanted(self, item: Samples) -> bool:
        """Have a channel that describes these columns; return whether a viewer has subscribed to it."""
        topic, columns = item.stream or MAIN, {"sample", *item.block.columns}
        known = self._columns.get(topic, set())
        if not columns <= known:
            self._columns[topic] = columns | known
            if topic in self._channels:
                self._channels[topic].close()
            self._channels[topic] = self._channel(topic, self._columns[topic])
        return bool(self._channels[topic].has_sinks())

    def _channel(self, topic: str, columns: set[str]) -> foxglove.Channel:
        """Return a channel whose schema has unit and meaning of each column."""
        properties = {}
        for name in sorted(columns):
            known = KNOWN.get(name, Column(name, "1"))
            texts = (self._units.get(name) or known.unit, known.description)
            properties[name] = {"type": "number", "description": ": ".join(filter(None, texts))}
        schema = {"type": "object", "title": f"imumon.{topic}", "properties": properties}
        return foxglove.Channel(f"/{topic}", schema=schema, context=self._context)
