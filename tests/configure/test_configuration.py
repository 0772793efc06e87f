"""Configuring: what is asked for becomes true, or the device is as it was, whatever fails and whenever."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from imumon.configure.configuration import planned
from imumon.configure.core import BAUD, PacketKind, Values, Wish
from imumon.configure.mip import MipFirmware
from imumon.errors import ImumonError, Reason
from imumon.transport.settings import PortSettings
from tests.configure.faults import Faults
from tests.configure.looped import Looped, failed, looped

DEVICES = ("xsens", "microstrain", "vectornav", "witmotion")
WISH, BAUDRATE = Wish(20.0, ("inertial", "temperature")), 230_400
FAST = {"xsens": 400.0, "microstrain": 250.0, "vectornav": 800.0 / 3, "witmotion": 200.0}
UNHEARD = 3
"""Commands in a row that are not heard: a request and its repetitions."""


def succeeded(one: Looped, wish: Wish = WISH, baudrate: int | None = BAUDRATE, save: bool = True) -> Looped:
    one.configuration.run(replace(wish, baudrate=baudrate, save=save))
    return one


def outcome(one: Looped) -> ImumonError | None:
    """Return why a configuration failed, if it did."""
    try:
        succeeded(one)
    except ImumonError as error:
        return error
    return None


FAULTS: dict[str, Callable[[frozenset[int]], Faults]] = {
    "refused": lambda hit: Faults(refused=hit),
    "unheard": lambda hit: Faults(unheard=hit),
    "ignored": lambda hit: Faults(ignored=hit),
}


@pytest.fixture(params=DEVICES)
def name(request: pytest.FixtureRequest) -> str:
    assert isinstance(request.param, str)
    return request.param


def commands_of(monkeypatch: pytest.MonkeyPatch, name: str) -> int:
    """Return how many commands a configuration takes."""
    return succeeded(looped(monkeypatch, name)).port.spoilt.commands


@pytest.mark.parametrize("rate", [1.0, 10.0, 100.0, 0.0])
def test_the_device_sends_what_was_requested(monkeypatch: pytest.MonkeyPatch, name: str, rate: float) -> None:
    rate = rate or FAST[name]
    one = succeeded(looped(monkeypatch, name), Wish(rate, ("inertial", "temperature", "attitude")), 460_800)
    stream, report = one.report.stream, one.report
    assert stream is not None
    assert report.result == "done"
    assert report.saved
    assert {"gyro_x", "accel_z", "temperature"} <= set(stream.columns)
    assert "mag_x" not in stream.columns
    assert stream.rate_hz == pytest.approx(rate, rel=0.05)
    assert one.port.firmware.baudrate == one.port.settings.baudrate == 460_800


def test_the_load_is_what_really_comes(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    one = succeeded(looped(monkeypatch, name), Wish(100.0, ("inertial", "temperature", "attitude")))
    one.port.read(1.0)  # what was under way
    heard = sum(len(one.port.read(0.05)) for _ in range(200)) / 10
    family = one.configuration._family
    assert heard == pytest.approx(family.bytes_per_s(one.port.firmware.volatile), rel=0.01)


def test_flash_is_written_only_on_request(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    one = looped(monkeypatch, name)
    settings = one.port.firmware
    if name == "xsens":
        assert "flash at once" in failed(one, replace(WISH, baudrate=BAUDRATE)).seen
        assert one.as_found
        return
    succeeded(one, save=False)
    assert settings.flash == settings.delivered != settings.volatile
    one.port.firmware.power_on()
    assert one.as_found
    saved = succeeded(looped(monkeypatch, name)).port.firmware
    assert saved.flash == saved.volatile != saved.delivered
    saved.power_on()
    assert saved.baudrate == BAUDRATE


def test_nothing_is_written_when_nothing_is_to_change(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    one = looped(monkeypatch, name)
    succeeded(one, save=True)
    again = looped(monkeypatch, name)
    there, before = again.port.firmware, one.port.firmware
    there.volatile, there.flash, there.delivered = before.volatile, before.flash, before.delivered
    again.port.firmware.baudrate = BAUDRATE
    again.port.set_baudrate(BAUDRATE)
    succeeded(again, save=False)
    assert again.report.result == "unchanged"
    assert again.report.plan == []
    looked = looped(monkeypatch, name)
    succeeded(looked, Wish(), None, save=False)
    assert looked.report.result == "read"
    assert looked.report.before.keys() == looked.report.after.keys()
    assert looked.as_found


@pytest.mark.parametrize("fault", ["refused", "unheard", "ignored"])
def test_what_fails_at_any_command_leaves_the_device_as_it_was(
    monkeypatch: pytest.MonkeyPatch, name: str, fault: str
) -> None:
    total, failures = commands_of(monkeypatch, name), 0
    for k in range(1, total + 1):
        one = looped(monkeypatch, name)
        hit = frozenset(range(k, k + UNHEARD) if fault == "unheard" else [k])
        one.port.spoilt.faults = FAULTS[fault](hit)
        error = outcome(one)
        if error is not None:
            failures += 1
            assert error.reason in (Reason.REFUSED, Reason.SILENT, Reason.BAD_DATA), (k, error)
            assert one.as_found, (k, error, one.port.firmware.volatile)
            assert not one.report.not_restored, (k, one.report)
        else:
            volatile = one.port.firmware.volatile
            assert one.port.firmware.baudrate == BAUDRATE, k
            assert one.report.stream is not None
            assert volatile[BAUD] != one.port.firmware.delivered[BAUD], k
    assert failures >= (2 if fault == "ignored" else 4)


def test_ctrl_c_at_any_command_leaves_the_device_as_it_was(
    monkeypatch: pytest.MonkeyPatch, name: str
) -> None:
    writes = succeeded(looped(monkeypatch, name)).port.writes
    for k in range(1, writes + 1):
        one = looped(monkeypatch, name)

        def interrupt(number: int, k: int = k) -> None:
            if number == k:
                raise KeyboardInterrupt

        one.port.on_write = interrupt
        with pytest.raises(KeyboardInterrupt):
            one.configuration.run(replace(WISH, baudrate=BAUDRATE, save=True))
        assert one.as_found, k
        assert one.report.result == "failed"


@pytest.mark.parametrize("end", ["dies", "is unplugged"])
def test_what_cannot_be_put_back_is_reported(monkeypatch: pytest.MonkeyPatch, name: str, end: str) -> None:
    total = commands_of(monkeypatch, name)
    said = 0
    for k in range(total):
        one = looped(monkeypatch, name)
        one.port.spoilt.faults = Faults(dies_after=k) if end == "dies" else Faults(unplugged_after=k)
        error = outcome(one)
        assert error is None or error.reason in (Reason.SILENT, Reason.LOST, Reason.REFUSED)
        changed = one.port.firmware.volatile != one.port.firmware.delivered
        if one.report.result == "failed" and changed:
            said += 1
            assert one.report.not_restored, k
    assert said > 2


@pytest.mark.parametrize("name", ["xsens", "microstrain", "vectornav"])
def test_a_device_that_is_left_silent_is_reported(monkeypatch: pytest.MonkeyPatch, name: str) -> None:
    """It was told to be quiet, and does not answer any more when it is told to send again."""
    left = 0
    for k in range(2, commands_of(monkeypatch, name)):
        one = looped(monkeypatch, name)
        one.port.spoilt.faults = Faults(dies_after=k)
        if outcome(one) is not None and one.report.result == "failed" and not one.port.firmware.streaming:
            left += 1
            assert "sending of data: on" in one.report.not_restored, k
    assert left > 2


def test_more_than_the_line_carries_is_refused_before_anything_is_written(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    one = looped(monkeypatch, "witmotion")
    error = failed(one, Wish(200.0, ("inertial", "attitude")))
    assert "6600 bytes/s are 688% of what 9600 baud carry (960)" in error.seen
    assert "--baud" in error.hint
    assert one.as_found
    assert one.report.plan == []
    succeeded(looped(monkeypatch, "witmotion"), Wish(200.0, ("inertial", "attitude")), 115_200)


def test_a_slower_line_comes_after_less_data(monkeypatch: pytest.MonkeyPatch) -> None:
    one = succeeded(looped(monkeypatch, "vectornav"), Wish(10.0, ("inertial",)), 9600)
    assert [request.meaning.split(":")[0] for request in one.report.plan][-1] == BAUD
    assert one.port.firmware.baudrate == 9600


def test_an_older_mip_device_is_recognised_by_its_own_commands(monkeypatch: pytest.MonkeyPatch) -> None:
    one = looped(monkeypatch, "microstrain")
    assert isinstance(one.port.firmware, MipFirmware)
    one.port.firmware.family.modern = False
    succeeded(one)
    assert one.report.plan[1].frame[4:6] == bytes([len(one.report.plan[1].frame) - 6, 0x08])
    assert one.report.stream is not None
    assert one.report.stream.rate_hz == pytest.approx(20.0, rel=0.05)


def slow_down(monkeypatch: pytest.MonkeyPatch, one: Looped, by: int) -> None:
    """Let a device send more slowly than it states."""
    family = one.port.firmware.family
    real = family.kinds

    def kinds(values: Values) -> list[PacketKind]:
        return [
            kind._replace(fields=[field._replace(rate_hz=field.rate_hz / by) for field in kind.fields])
            for kind in real(values)
        ]

    monkeypatch.setattr(family, "kinds", kinds)


def test_a_device_that_sends_at_another_rate_than_it_states_is_put_back(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    one = looped(monkeypatch, "vectornav")
    slow_down(monkeypatch, one, 2)
    assert "Hz, not at 20 Hz" in failed(one, WISH).seen
    assert one.as_found


def test_a_device_that_hardly_sends_is_put_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """Of one or two samples no rate can be told, and it was taken for the right one."""
    one = looped(monkeypatch, "vectornav")
    slow_down(monkeypatch, one, 20)
    assert "s, not at 20 Hz" in failed(one, WISH).seen
    assert one.as_found


def test_a_baud_rate_that_could_not_be_put_back_is_not_changed(monkeypatch: pytest.MonkeyPatch) -> None:
    one = looped(monkeypatch, "witmotion")
    settings = one.port.firmware
    settings.volatile[BAUD] = settings.flash[BAUD] = settings.delivered[BAUD] = b"\x77\x00"
    assert "could not put back: code 77" in failed(one, replace(WISH, baudrate=BAUDRATE)).seen
    assert one.as_found


def test_who_else_reads_the_port_is_reported(monkeypatch: pytest.MonkeyPatch) -> None:
    one = looped(monkeypatch, "vectornav")
    one.port.shared_with = ("minicom (7)",)
    succeeded(one, Wish(), None, save=False)
    assert one.report.warnings == ["minicom (7) reads this port, too: answers may go there"]


def test_a_silent_device_is_left_silent_when_it_fails(monkeypatch: pytest.MonkeyPatch) -> None:
    one = looped(monkeypatch, "microstrain")
    one.port.firmware.streaming = False
    one.configuration._link.streaming = False
    one.port.spoilt.faults = Faults(refused=frozenset([12]))
    failed(one, WISH)
    assert not one.port.firmware.streaming


def test_a_dry_run_needs_no_device(name: str) -> None:
    from imumon.configure.core import family_of
    from imumon.protocols.device import load_device

    family, line = family_of(load_device(name)), PortSettings("/dev/none", 9600)
    wish = replace(WISH, baudrate=BAUDRATE, save=True)
    frames = [request.frame for request in planned(family, wish, line)]
    assert frames[0] == family.hello.frame
    assert len(frames) > 6
    with pytest.raises(ImumonError, match="does not know what the device sends now"):
        planned(family, Wish(20.0), line)
