"""Frames of commands against frames that others made: documents, and programs that talk to devices."""

from __future__ import annotations

import pytest

from imumon.configure import WING, mip, vectornav, witmotion, xsens
from imumon.configure.core import BAUD, USUAL_COLUMNS, Family, Wish, divisor, family_of
from imumon.errors import ImumonError
from imumon.protocols.device import load_device
from imumon.protocols.mip import MipDevice

XSENS_CONFIGURED = (
    "FA FF C0 30 10 20 FF FF 10 60 FF FF 10 10 FF FF 20 10 01 90 40 20 01 90 40 30 01 90 80 20 01 90 "
    "C0 20 00 64 E0 20 FF FF 50 42 01 90 50 22 01 90 D0 12 01 90 98"
)
"""SetOutputConfiguration of an MTi-680, from a third party's program."""
DEVICES = ("xsens", "microstrain", "vectornav", "witmotion")
MICROSTRAIN = MipDevice.model_validate(load_device("microstrain").model_dump())


def test_xsens_frames_are_those_of_other_programs() -> None:
    assert xsens.frame(0x30).hex(" ") == "fa ff 30 00 d1"
    assert xsens.frame(0x10).hex(" ") == "fa ff 10 00 f1"
    taken = bytes.fromhex(XSENS_CONFIGURED)
    assert xsens.frame(0xC0, taken[4:-1]) == taken
    euler = bytes.fromhex("FAFFC010 1020FFFF 1060FFFF 20300064 E020FFFF E3".replace(" ", ""))
    made = xsens.packed([(0x1020, 0xFFFF), (0x1060, 0xFFFF), (0x2030, 100), (0xE020, 0xFFFF)])
    assert xsens.frame(0xC0, made) == euler
    assert len(xsens.frame(0xC0, bytes(300))) == 307


def test_mip_frames_are_those_of_the_vendor_and_of_other_programs() -> None:
    family = mip.Mip(MICROSTRAIN)
    family.modern = False
    assert family.hello.frame.hex(" ") == "75 65 01 02 02 01 e0 c6"
    assert family.quiet[0].frame.hex(" ") == "75 65 01 02 02 02 e1 c7"
    sensors = mip.message_format([(0x04, 1), (0x05, 1)])
    assert family.write(mip.SENSOR_FORMAT, sensors)[0].frame.hex() == "75650c0a0a0801020400010500011073"
    filtered = mip.message_format([(0x05, 1), (0x0D, 1)])
    assert family.write(mip.FILTER_FORMAT_NAME, filtered)[0].frame.hex() == "75650c0a0a0a01020500010d00011ba3"
    answer, _ = family.messages(bytes.fromhex("75 65 01 04 04 F1 01 00 D5 6A"))
    assert family.hello.answer is not None
    assert family.hello.answer(answer[0]) == b""


def test_vectornav_frames_are_those_of_other_programs() -> None:
    family = vectornav.VectorNav()
    assert family.read(vectornav.OUTPUT).frame == b"$VNRRG,75*71\r\n"
    assert family.quiet[0].frame == b"$VNASY,0*4F\r\n"
    assert family.save(())[0].frame == b"$VNWNV*57\r\n"
    assert family.write(vectornav.ASCII, b"0")[0].frame == b"$VNWRG,06,0*6C\r\n"
    assert family.write(vectornav.OUTPUT, b"1,4,01,0101")[0].frame == b"$VNWRG,75,1,4,01,0101*70\r\n"
    assert family.write(BAUD, b"115200")[0].frame == b"$VNWRG,05,115200*58\r\n"


@pytest.mark.parametrize("line", ["$VNRRG,75,3,400,01,0321*3B31", "$VNRRG,06,1,1*0865", "$VNERR,03*72"])
def test_vectornav_answers_with_either_checksum(line: str) -> None:
    messages, done = vectornav.VectorNav().messages(f"\xfa{line}\r\n".encode("latin-1"))
    assert [message.kind for message in messages] == [line[3:6]]
    assert done == len(line) + 3


def test_vectornav_leaves_the_port_out_that_newer_firmware_adds() -> None:
    family = vectornav.VectorNav()
    (message,), _ = family.messages(b"$VNRRG,06,1,1*0865\r\n")
    reader = family.read(vectornav.ASCII).answer
    assert reader is not None
    assert reader(message) == b"1"


def test_vectornav_asks_for_what_the_filter_has_not_corrected() -> None:
    wanted = vectornav.VectorNav().wanted({}, Wish(100.0, ("inertial", "temperature")))
    shown = vectornav.VectorNav().describe(vectornav.OUTPUT, wanted[vectornav.OUTPUT])
    assert shown.endswith("Common Imu: TimeStartup, UncompAccel, UncompGyro, Temperature")
    found = vectornav.Output.read(wanted[vectornav.OUTPUT]).contents
    assert found is not None
    assert found.end + 2 == 2 + 4 + 8 + 12 + 12 + 4 + 2
    assert wanted[vectornav.OUTPUT] == b"1,8,05,0001,001C"


def test_witmotion_frames_are_those_of_the_vendor() -> None:
    unlock, write = witmotion.WitMotion().write(witmotion.RATE, b"\x0b\x00")
    assert unlock.frame.hex(" ") == "ff aa 69 88 b5"
    assert write.frame.hex(" ") == "ff aa 03 0b 00"
    assert witmotion.WitMotion().save(())[1].frame.hex(" ") == "ff aa 00 00 00"
    assert witmotion.WitMotion().read(witmotion.CONTENT).frame.hex(" ") == "ff aa 27 02 00"
    assert witmotion.WitMotion().baud_codes[115_200] == b"\x06\x00"


@pytest.mark.parametrize("name", DEVICES)
def test_every_family_speaks_the_shared_words(name: str) -> None:
    family = family_of(load_device(name))
    assert family.columns.keys() <= USUAL_COLUMNS.keys()
    wanted = family.wanted({}, Wish(100.0, tuple(family.columns)))
    assert family.bytes_per_s(wanted) > 1000
    assert all(family.describe(setting, value) for setting, value in wanted.items())
    for rate in family.baud_codes:
        assert family.baud_of(family.baud_codes[rate]) == rate


def test_what_a_family_lacks_is_named() -> None:
    family = witmotion.WitMotion()
    with pytest.raises(ImumonError, match=r"have no output 'increments'\n.*inertial, magnetometer"):
        family.check(Wish(10.0, ("increments",)))
    with pytest.raises(ImumonError, match=r"no output 'gyro'"):
        family.check(Wish(10.0, ("gyro",)))
    with pytest.raises(ImumonError, match=r"no baud rate 12345\n.*9600"):
        family.check(Wish(baudrate=12_345))
    with pytest.raises(ImumonError, match="does not configure stim300"):
        family_of(load_device("stim300"))
    assert all(load_device(name).protocol in WING.firmware for name in DEVICES)


@pytest.mark.parametrize(
    ("family", "rate", "near"),
    [
        (xsens.Xsens(), 300.0, "200 and 400"),
        (xsens.Xsens(), 450.0, "400 Hz"),
        (mip.Mip(MICROSTRAIN), 300.0, "250 and 500"),
        (vectornav.VectorNav(), 300.0, "266.667 and 400"),
        (witmotion.WitMotion(), 300.0, "200 Hz"),
        (vectornav.VectorNav(), 1e4, "800 Hz"),
    ],
)
def test_a_rate_that_does_not_exist_is_refused_with_the_nearest(
    family: Family, rate: float, near: str
) -> None:
    with pytest.raises(ImumonError, match=near):
        family.wanted({}, Wish(rate, ("inertial",)))


def test_an_output_that_is_slower_than_requested_is_refused_alone() -> None:
    with pytest.raises(ImumonError, match=r"400 Hz .these outputs are slower.\nnearest: 100 Hz"):
        xsens.Xsens().wanted({}, Wish(400.0, ("magnetometer",)))
    both = xsens.Xsens().wanted({}, Wish(400.0, ("inertial", "magnetometer")))[xsens.OUTPUT]
    assert xsens.entries(both)[2:] == [(0x4020, 400), (0x8020, 400), (0xC020, 100)]


def test_a_rate_may_be_rounded_as_people_do() -> None:
    assert divisor(800, 266.67) == 3
    with pytest.raises(ImumonError, match="nearest"):
        divisor(800, 266)


def test_what_is_not_requested_stays() -> None:
    family, kept = vectornav.VectorNav(), vectornav.Output(2, 40, 0x14, (0x3E, 0x3A))
    present = {vectornav.OUTPUT: kept.value, vectornav.ASCII: b"14"}
    wanted = family.wanted(present, Wish(rate_hz=200.0))
    assert wanted == {vectornav.OUTPUT: b"2,4,14,003E,003A"}
    assert family.wanted(present, Wish(outputs=("inertial",)))[vectornav.OUTPUT] == b"2,40,05,0001,000C"
    others = present | {vectornav.SECOND: b"1,8,01,0001"}
    assert family.wanted(others, Wish(rate_hz=200.0)) == wanted
    changed = family.wanted(others, Wish(200.0, ("inertial",)))
    assert changed[vectornav.ASCII] == b"0"
    assert changed[vectornav.SECOND] == b"0,8,01,0001"
    present = {xsens.OUTPUT: xsens.packed([(0x1020, 0xFFFF), (0x8020, 100), (0xC020, 100), (0x5042, 4)])}
    faster = xsens.Xsens().wanted(present, Wish(rate_hz=400.0))[xsens.OUTPUT]
    assert xsens.entries(faster) == [(0x1020, 0xFFFF), (0x8020, 400), (0xC020, 100), (0x5042, 4)]
    present = {mip.SENSOR_FORMAT: mip.message_format([(4, 10), (5, 5)]), mip.FILTER_FORMAT_NAME: b"\0"}
    changed = mip.Mip(MICROSTRAIN).wanted(present, Wish(outputs=("inertial",)))
    assert changed[mip.SENSOR_FORMAT] == mip.message_format([(0xD5, 5), (4, 5), (5, 5)])


def test_an_mti_may_send_slowly_what_is_not_inertial() -> None:
    family, wanted = xsens.Xsens(), [(0x8020, 100), (0x0810, 100)]
    assert family.settled(xsens.OUTPUT, xsens.packed(wanted), xsens.packed([(0x8020, 100), (0x0810, 1)]))
    assert not family.settled(xsens.OUTPUT, xsens.packed(wanted), xsens.packed([(0x8020, 50), (0x0810, 100)]))
    assert not family.settled(xsens.OUTPUT, xsens.packed(wanted), xsens.packed([(0x8020, 100)]))
