"""Configuring a device: read, plan, write, read back, listen, save; and back as it was if anything fails."""

import signal
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import dataclass, field, replace
from typing import Any

from imumon.errors import ImumonError, Reason, bad_config, bad_data
from imumon.protocols.device import DeviceFile
from imumon.transport.settings import PortSettings

from .command_link import HEAR_S, CommandLink, Stream, measure
from .core import BAUD, CommandError, Family, Request, Values, Wish

WAKE_S = 2.0
"""How long a device is queried at a new baud rate; the slowest to change that is known waits 0.25 s."""


@dataclass
class Report:
    """What was found, planned, sent and achieved; it grows as the work goes on.

    `sent` is as `CommandLink.sent`; `result` planned, read, unchanged, done, or failed; `flash_begun`:
    whether anything was sent that writes into flash.
    """

    device: str
    port: str
    identity: tuple[str, ...] = ()
    assumed: tuple[str, ...] = ()
    verified: str = ""
    before: dict[str, str] = field(default_factory=dict)
    after: dict[str, str] = field(default_factory=dict)
    plan: list[Request] = field(default_factory=list)
    sent: list[tuple[Request, bool | None]] = field(default_factory=list)
    warnings: list[str] = field(default_factory=list)
    stream: Stream | None = None
    result: str = "failed"
    saved: bool = False
    flash_begun: bool = False
    restored: list[str] = field(default_factory=list)
    not_restored: list[str] = field(default_factory=list)

    def as_dict(self) -> dict[str, Any]:
        """Return the report as JSON has it."""
        stream = self.stream
        return {
            **vars(self),
            "plan": [request.as_dict() for request in self.plan],
            "sent": [{**request.as_dict(), "answered": answered} for request, answered in self.sent],
            "stream": stream and {name: getattr(stream, name) for name in ("seconds", "rate_hz", "columns")},
        }


def planned(family: Family, wish: Wish, line: PortSettings) -> list[Request]:
    """Return all that would be sent, in order, to a device on a line as it is now.

    Raises BAD_CONFIG when that depends on what the device sends now, and as `check_load`.
    """
    if (wish.rate_hz is None) != (wish.outputs is None):
        raise bad_config(
            "a dry run sends nothing, so it does not know what the device sends now",
            "give both --rate and --outputs, or leave --dry-run out and --save too: flash stays as it is",
        )
    values = family.wanted({}, wish)
    if wish.rate_hz is not None:
        check_load(family, values, line, wish)
    names = _in_order(values, wish, line.baudrate)
    found = [family.hello, *family.quiet, *family.questions, *map(family.read, family.settings)]
    found += [request for name in names for request in family.write(name, values[name])]
    found += [*map(family.read, names), *family.resume]
    return [*found, *family.save(names)] if wish.save else found


def _in_order(names: Iterable[str], wish: Wish, now: int) -> list[str]:
    """Return settings in the order of changing: a faster line before more data, a slower one after less."""
    faster = (wish.baudrate or 0) > now
    return sorted(names, key=lambda name: name != BAUD) if faster else list(names)


def check_load(family: Family, values: Values, line: PortSettings, wish: Wish) -> None:
    """Raise BAD_CONFIG when the settings send more than the line carries at its new baud rate."""
    line = replace(line, baudrate=wish.baudrate or line.baudrate)
    needed, there = family.bytes_per_s(values), line.capacity_bytes_per_s
    if there is not None and needed > there:
        raise bad_config(
            f"{needed:.0f} bytes/s are {needed / there:.0%} of what {line.baudrate} baud carry ({there:.0f})",
            "ask for fewer outputs or a lower rate, or set a higher --baud",
        )


class Configuration:
    """One device that is being configured.

    `report` is written as the work goes on; `progress` gets a line for each step.
    """

    def __init__(
        self,
        link: CommandLink,
        device: DeviceFile,
        report: Report,
        progress: Callable[[str], None],
    ) -> None:
        self._link, self._family, self._device = link, link.family, device
        self._report, self._progress = report, progress
        report.sent = link.sent
        self._present: dict[str, bytes] = {}
        self._wanted: dict[str, bytes] = {}
        """Settings of the device before, and those that the wish needs."""
        self._begun: list[str] = []
        """Names of those whose change has begun."""
        self._saving: tuple[str, ...] = ()

    def run(self, wish: Wish) -> None:
        """Make the wish true, or leave the device as it was.

        Raises BAD_CONFIG when the device has no such rate, or it does not fit through the line; REFUSED when
        the device refuses or does something else; SILENT when it stops answering; LOST.  What was changed has
        been put back, and the report lists what could not be.
        """
        try:
            changes = self._prepare(wish)
            self._carry_out(changes, wish)
            if wish.save:  # also where it was so already
                self._saving = tuple(self._wanted)
                for request in self._family.save(self._saving):
                    self._report.flash_begun = True
                    self._show(request)
                    self._link.ask(request)
                self._report.saved = True
        except BaseException as error:
            with _uninterrupted():
                self._restore()
            if isinstance(error, CommandError):
                raise ImumonError(Reason.REFUSED if error.refused else Reason.SILENT, str(error)) from error
            raise

    def _prepare(self, wish: Wish) -> dict[str, bytes]:
        """Read the device and return which settings are to change, in order; nothing is written yet."""
        link, report, family = self._link, self._report, self._family
        if link.port.shared_with:
            others = ", ".join(link.port.shared_with)
            report.warnings.append(f"{others} reads this port, too: answers may go there")
        self._try_each(family.quiet)
        family.learn(link.ask)
        self._present = {name: link.ask(family.read(name)) for name in family.settings}
        report.identity = family.identity
        report.before = {name: family.describe(name, value) for name, value in self._present.items()}
        self._wanted = wanted = family.wanted(self._present, wish)
        after = self._present | wanted
        report.after = {name: family.describe(name, value) for name, value in after.items()}
        line = link.port.settings
        if wanted:
            check_load(family, after, line, wish)
        changes = {
            name: wanted[name]
            for name in _in_order(wanted, wish, line.baudrate)
            if not family.settled(name, wanted[name], self._present[name])
        }
        report.plan = [request for change in changes.items() for request in family.write(*change)]
        if BAUD in changes and family.baud_of(self._present[BAUD]) is None:
            raise bad_data(
                f"the device reports a baud rate that imumon could not put back: {report.before[BAUD]}",
                "leave --baud out",
            )
        if changes and family.stores_at_once and not wish.save:
            raise bad_config(
                f"{family.title} devices write each setting into flash at once, so nothing was changed",
                "add --save if the settings may stay for good (--dry-run shows them)",
            )
        return changes

    def _carry_out(self, changes: dict[str, bytes], wish: Wish) -> None:
        """Write what changes, read it back, and listen to what comes."""
        report, family = self._report, self._family
        for request in report.plan:
            self._show(request)
        for name, value in changes.items():
            self._begun.append(name)
            report.flash_begun |= family.stores_at_once
            self._apply(name, value)
        self._try_each(family.resume)
        report.result = "done" if changes else "read" if wish.only_reads else "unchanged"
        if not changes:
            return
        rate = family.rate_hz(self._present | changes)
        wanted = [family.columns[name] for name in wish.outputs or ()]
        report.stream = stream = measure(self._link, self._device, rate)
        report.warnings += stream.warnings
        if problem := stream.problem(wanted, rate):
            raise ImumonError(
                Reason.REFUSED,
                f"the device takes the settings and reads them back, but {problem}",
                "" if stream.columns else "the output may go to another port of the device",
            )

    def _show(self, request: Request) -> None:
        self._progress(f"  {request.shown}\n      {request.meaning}")

    def _apply(self, name: str, value: bytes) -> None:
        """Write a setting and prove that it reads back."""
        if name == BAUD:
            self._change_speed(value)
        else:
            for request in self._family.write(name, value):
                self._link.ask(request)
        read = self._family.read(name)
        found = self._link.ask(read)
        if not self._family.settled(name, value, found):
            what = self._family.describe
            raise CommandError(read, f"it is {what(name, found)}, not {what(name, value)}", refused=True)

    def _change_speed(self, value: bytes) -> None:
        """Change the baud rate of the device and follow it; go back when it does not answer there."""
        line, new = self._link.port, self._family.baud_of(value)
        old = line.settings.baudrate
        assert new is not None
        line.set_baudrate(new)  # refused now, not when the device has gone there
        line.set_baudrate(old)
        requests = self._family.write(BAUD, value)
        for request in requests:
            self._link.ask(request)
        if not self._link.answers_at(new, WAKE_S + self._family.reset_s):
            line.set_baudrate(old)
            raise CommandError(requests[0], f"no answer at {new} baud", refused=False)
        self._try_each(self._family.quiet)

    def _restore(self) -> None:
        """Put back what was begun, the last first, and let the data come again if they came before."""
        self._report.result = "failed"
        left, silent = self._begun[::-1], self._link.streaming and bool(self._family.resume)
        try:
            if left:
                self._progress("putting the device back as it was")
                self._find()
            while left:
                self._put_back(left[0])
                left.pop(0)
            for request in self._family.save(self._saving) if self._saving else ():
                self._link.ask(request)
            if silent:
                self._try_each(self._family.resume)
                silent = False
        except (CommandError, ImumonError) as error:
            self._report.not_restored += map(self._shown, left)
            with suppress(ImumonError):
                silent = silent and not self._link.discard(HEAR_S)
            self._report.not_restored += ["sending of data: on"] if silent else []
            self._report.warnings.append(f"putting back stopped: {error}".splitlines()[0])

    def _put_back(self, name: str) -> None:
        """Put a setting back; one that the device refuses does not keep the others from it."""
        try:
            self._apply(name, self._present[name])
        except CommandError as error:
            if not error.refused:
                raise
            self._report.not_restored.append(f"{self._shown(name)} ({error.why})")
        else:
            self._report.restored.append(self._shown(name))

    def _shown(self, name: str) -> str:
        return f"{name}: {self._family.describe(name, self._present[name])}"

    def _find(self) -> None:
        """Find the rate at which the device answers now, and let it be quiet."""
        rates, patience = [self._link.port.settings.baudrate], WAKE_S
        if BAUD in self._begun:
            patience += self._family.reset_s
            values = (self._present[BAUD], self._wanted[BAUD])
            rates += [rate for value in values if (rate := self._family.baud_of(value))]
        if not any(self._link.answers_at(rate, patience) for rate in dict.fromkeys(rates)):
            raise ImumonError(Reason.SILENT, "the device does not answer any more")
        self._try_each(self._family.quiet)

    def _try_each(self, requests: Sequence[Request]) -> None:
        """Ask; a device that does not know how to be quiet is configured between its data."""
        for request in requests:
            try:
                self._link.ask(request)
            except CommandError as error:
                if not error.refused or self._family.hello_quiets:
                    raise


@contextmanager
def _uninterrupted() -> Iterator[None]:
    """Hold off Ctrl-C while a device is put back as it was."""
    numbers = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    before = {number: signal.signal(number, signal.SIG_IGN) for number in numbers}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
