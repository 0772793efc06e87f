"""The option --publish: live samples for other programs."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import click

from imumon.cli.common import warn

if TYPE_CHECKING:
    from imumon.publishing.publisher import Publisher
    from imumon.publishing.target import Target
    from imumon.view.items import ViewItem, ViewSetup


class _Publish:
    """The option `--publish` of `imumon monitor`."""

    name = "publish"
    option = staticmethod(
        click.option(
            "--publish",
            multiple=True,
            metavar="KIND[=HOST:PORT]",
            help="Send the samples, too: udp-json, foxglove or ros2; without an address to this computer"
            " alone.",
        )
    )

    def parse(self, given: Sequence[str]) -> list[Target]:
        """Return the targets of --publish; say of those beyond this computer that they are."""
        if not given:
            return []
        from imumon.publishing.target import parse_target

        targets = [parse_target(text) for text in given]
        warn(target.warning for target in targets if target.warning is not None)
        return targets

    def start(self, parsed: Sequence[Target], setup: ViewSetup) -> Published:
        """Begin to send to them."""
        if not parsed:
            return Published([])
        from imumon.publishing.publisher import Publisher

        return Published([Publisher(target, setup).start() for target in parsed])


PUBLISH = _Publish()


class Published:
    """Everything that --publish asks for, while a command runs."""

    def __init__(self, publishers: Sequence[Publisher]) -> None:
        self._publishers = publishers
        self._reported: dict[Publisher, str] = {}

    @property
    def publish(self) -> list[Callable[[ViewItem], None]]:
        """Where view items go."""
        return [one.publish for one in self._publishers]

    @property
    def text(self) -> str:
        """What a status line says: where it goes, and what of it was dropped."""
        texts = []
        for one in self._publishers:
            state = one.state
            dropped = f", {state.dropped:,} dropped" if state.dropped else ""
            text = f"{state.sent:,} sent{dropped}" if state.ready else state.text
            texts.append(f"  {one.target.kind}: {text}")
        return "".join(texts)

    @property
    def as_data(self) -> dict[str, object]:
        """What the command says with --json."""
        states = [(str(one.target), one.state) for one in self._publishers]
        return {
            "published": [{"to": to, "sent": state.sent, "dropped": state.dropped} for to, state in states]
        }

    @property
    def rows(self) -> dict[str, str]:
        """What the summary says."""
        states = [(one.target, one.state) for one in self._publishers]
        texts = [f"{to}: {state.sent:,} sent, {state.dropped:,} dropped" for to, state in states]
        return {"published": "; ".join(texts)} if texts else {}

    def announce(self, tell: Callable[[str, str], None]) -> None:
        """Say how it goes, when that changes, and when the first is dropped."""
        for one in self._publishers:
            state = one.state
            text = f"{one.target}: {state.text}" + (", some are dropped" if state.dropped else "")
            if text != self._reported.get(one, ""):
                self._reported[one] = text
                tell("INFO" if state.ready and not state.dropped else "WARN", f"published to {text}")

    def close(self) -> None:
        """Send what is left, and end."""
        for one in self._publishers:
            one.close()
