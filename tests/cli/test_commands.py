"""The command line as a user or a program meets it: its output, its exit code, the end of its process."""

from __future__ import annotations

import csv
import json
import os
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import click
import numpy as np
import pyarrow.parquet as pq
import pytest

from imumon import cli
from imumon.cli import commands
from imumon.cli.live_run import Ending, ending_signals
from imumon.errors import EXIT_INTERRUPTED
from imumon.protocols.device import load_device
from imumon.recordings.recorder import Recorder
from imumon.simulation.unit import SimulatedUnit, load_scenario
from imumon.simulation.virtual_device import VirtualDevice
from tests.cli.command import IMUMON, answer, imumon
from tests.data_folder import measured
from tests.faults.port import FaultyPort
from tests.waiting import LIMIT_S, wait_until


@pytest.fixture(scope="module")
def capture(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two seconds of an AX1 as another tool would have captured it: cut at both ends, with one bad byte."""
    device = load_device("ax1")
    data = bytearray(b"".join(device.encoder().encode(SimulatedUnit(load_scenario("bench")).samples(200))))
    data[58 * 50 + 20] ^= 0x10
    path = tmp_path_factory.mktemp("capture") / "ax1.raw"
    path.write_bytes(data[30:-10])
    return path


def monitoring(ahrs: VirtualDevice, out: Path) -> list[str]:
    """Return the arguments of a recording to `out`."""
    return ["monitor", ahrs.port.path, "--device", "ax1", "--view", "none", "--out", str(out), "--json"]


def started(ahrs: VirtualDevice, out: Path, before: Sequence[str] = ()) -> subprocess.Popen[str]:
    """Start a real process that records to `out`."""
    command = [*before, IMUMON, *monitoring(ahrs, out)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def wait_for_bytes(session: Path, size: int = 30_000) -> int:
    """Wait until so much is on disk, by default of a hundred packets or more; return how much is."""
    wire = session / "wire.mcap"
    assert wait_until(lambda: wire.exists() and wire.stat().st_size > size)
    return wire.stat().st_size


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A session recorded by the real command from a virtual AHRS."""
    folder = tmp_path_factory.mktemp("recorded")
    with VirtualDevice(load_device("ax1"), folder / "ahrs") as ahrs:
        done = imumon(*monitoring(ahrs, folder / "s"), "--seconds", 2.5)
    assert done.returncode == 0, done.stderr
    result = json.loads(done.stdout)
    assert result["packets"] > 150
    assert result["bytes_recorded"] == result["bytes_received"]
    return folder / "s"


@pytest.mark.parametrize("disk", ["view", "both"])
def test_a_view_that_cannot_be_written_is_reported_once(
    disk: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    import rerun as rr

    def stopped(*_: object, **__: object) -> None:
        raise RuntimeError("File-writer thread shut down prematurely")

    monkeypatch.setattr(rr.RecordingStream, "flush", stopped)
    if disk == "both":
        monkeypatch.setattr(Recorder, "problem", "the recording cannot be written: No space left on device")
    with VirtualDevice(load_device("ax1"), tmp_path / "ahrs") as ahrs:
        done = imumon(*monitoring(ahrs, tmp_path / "s"), "--seconds", 1)
    (line,) = [line for line in done.stderr.splitlines() if "the view is not recorded any more" in line]
    assert "view.rrd cannot be written any more" in line
    assert f"imumon replay {tmp_path / 's'} --view native" in line
    assert ("wire.mcap has all so far" in line) == (disk == "view")
    assert ("No space left on device" in line) == (disk == "both")


def test_help_lists_every_command_and_imports_nothing_heavy() -> None:
    done = imumon("--help")
    assert done.returncode == 0
    for name in commands():
        assert f"  {name} " in done.stdout


def test_the_help_of_a_command_imports_nothing_heavy() -> None:
    code = (
        "import sys, imumon.cli\n"
        "heavy = 'numba numpy rerun pyarrow scipy matplotlib pint pydantic rich serial'.split()\n"
        "for name, command in imumon.cli.commands().items():\n"
        "    assert imumon.cli.run([name, '--help']) == 0\n"
        "    assert not sys.modules.keys() & set(heavy), name\n"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert done.stdout.count("Usage: ") == len(commands())


def test_a_shell_is_offered_what_may_come_next() -> None:
    asked = {**os.environ, "_IMUMON_COMPLETE": "bash_complete", "COMP_WORDS": "imumon re", "COMP_CWORD": "1"}
    done = subprocess.run([IMUMON], env=asked, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["plain,replay", "plain,recover", "plain,report"]


def test_decode_accounts_for_every_byte_of_a_capture(capture: Path, tmp_path: Path) -> None:
    result = answer("decode", capture, "--device", "ax1", "--out", tmp_path / "t.parquet")
    assert result["packets"] == result["rows"] == 197
    assert result["packets_by_type"] == {"ax1": 197}
    assert result["bytes_received"] == capture.stat().st_size
    assert result["bytes_received"] == (
        result["bytes_in_packets"] + result["bytes_skipped"] + result["bytes_pending"]
    )
    assert result["checksum_errors"] == 1
    assert result["counter_gaps"] == 1
    table = pq.read_table(tmp_path / "t.parquet")
    assert table.schema.field("gyro_x").metadata[b"unit"] == b"rad/s"
    assert str(table.schema.field("device_time_ns").type) == "int64"
    assert table["arrival_time_ns"].null_count == 197
    truth = SimulatedUnit(load_scenario("bench")).samples(200)
    kept = table["packet_counter"].to_numpy()
    np.testing.assert_allclose(table["gyro_z"].to_numpy(), truth["gyro_z"][kept], atol=1e-8)


def test_a_rate_that_nothing_shows_is_reported_and_can_be_given(tmp_path: Path) -> None:
    device, path = load_device("razor"), tmp_path / "razor.txt"
    path.write_bytes(b"".join(device.encoder().encode(SimulatedUnit(load_scenario("bench")).samples(200))))
    asked = ["decode", path, "--device", "razor", "--json"]
    assumed = imumon(*asked, "--out", tmp_path / "a.parquet")
    given = imumon(*asked, "--out", tmp_path / "g.parquet", "--rate", 20)
    assert "nothing shows whether they came at it" in assumed.stderr
    assert "--rate" not in given.stderr
    streams = [json.loads(done.stdout)["streams"]["imu"] for done in (assumed, given)]
    assert [stream["dated_by"] for stream in streams] == ["rows", "rows"]
    assert [stream["rate_hz"] for stream in streams] == pytest.approx([device.rate_hz, 20.0])


def test_decode_writes_the_same_numbers_as_csv(capture: Path, tmp_path: Path) -> None:
    answer("decode", capture, "--device", "ax1", "--out", tmp_path / "t.parquet")
    answer("decode", capture, "--device", "ax1", "--out", tmp_path / "t.csv", "--columns", "accel_x,status")
    with (tmp_path / "t.csv").open() as file:
        rows = list(csv.reader(file))
    assert rows[0] == ["accel_x", "status"]
    table = pq.read_table(tmp_path / "t.parquet")
    assert [float(row[0]) for row in rows[1:]] == table["accel_x"].to_pylist()
    assert [int(row[1]) for row in rows[1:]] == table["status"].to_pylist()


@pytest.mark.long
def test_a_recorded_session_replays_bit_for_bit(session: Path, tmp_path: Path) -> None:
    result = answer("replay", session, "--out", tmp_path / "a.parquet", "--speed", "max")
    assert result["identical_to_live"] is True
    decoded = answer("decode", session, "--out", tmp_path / "b.parquet")
    assert decoded["rows"] == result["rows"]
    replayed, plain = pq.read_table(tmp_path / "a.parquet"), pq.read_table(tmp_path / "b.parquet")
    assert replayed.select(plain.column_names).equals(plain)
    assert {f"temperature_rate_sd_{axis}" for axis in "xyz"} <= set(replayed.column_names)
    assert replayed.schema.field("temperature_rate_x").metadata[b"unit"] == b"degC/s"
    exported = answer("export", session, "--to", "csv", "--out", tmp_path / "c")
    assert exported["out"] == str(tmp_path / "c.csv")
    assert exported["rows"] == result["rows"]


def test_replay_at_a_speed_takes_its_time(session: Path) -> None:
    began = time.monotonic()
    result = answer("replay", session, "--speed", 4)
    assert time.monotonic() - began > 0.5
    assert result["identical_to_live"] is True


def test_a_session_that_was_changed_is_noticed(session: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    copy.mkdir()
    for name in ("session.yaml", "wire.mcap"):
        (copy / name).write_bytes((session / name).read_bytes())
    wire = bytearray((copy / "wire.mcap").read_bytes())
    wire[wire.index(b"\xa5\x5a", len(wire) // 2)] ^= 1  # the sync byte of a packet
    (copy / "wire.mcap").write_bytes(wire)
    done = imumon("replay", copy, "--json")
    assert json.loads(done.stdout)["identical_to_live"] is False
    assert "was changed" in done.stderr


def test_import_and_export_keep_every_row(tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("t,gx,gy,gz,temp\n0.00,1,2,3,25.5\n0.01,4,5,6,25.6\n0.02,7,8,9,\n")
    (tmp_path / "map.yaml").write_text(
        "time: {column: t, unit: s}\ngyro: {columns: [gx, gy, gz], unit: deg/s}\n"
        "temperature: {columns: [temp], unit: degC}\naxes: FLU\n"
    )
    result = answer("import", tmp_path / "log.csv", "--map", tmp_path / "map.yaml", "--out", tmp_path / "s")
    assert (result["rows_in"], result["rows_out"], result["rows_dropped"]) == (3, 3, 0)
    replay = answer("replay", tmp_path / "s", "--out", tmp_path / "t.parquet")
    assert replay["rows"] == 3
    table = pq.read_table(tmp_path / "t.parquet")
    np.testing.assert_allclose(np.rad2deg(table["gyro_y"].to_numpy()), [2, 5, 8])
    assert table["device_time_ns"].to_pylist() == [0, 10_000_000, 20_000_000]
    assert table["temperature"].null_count == 1


def test_measured_captures_decode_without_loss(tmp_path: Path) -> None:
    for path, device, packets in [
        ("aceinna/z1.raw", "openimu", 2127),
        ("xsens/mtdata2-1/output.bin", "xsens", 100),
        ("xsens/mtdata2-3/output.bin", "xsens", 100),
        ("microstrain/stream.bin", "microstrain", 4156),
    ]:
        result = answer("decode", measured(path), "--device", device, "--out", tmp_path / f"{device}.parquet")
        assert result["packets"] == packets, path
        assert result["bytes_skipped"] == result["checksum_errors"] == result["length_errors"] == 0, path
        assert result["clock_restarts"] == 0, path


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (["decode", "{capture}", "--device", "ax9", "--out", "t.csv"], 2, "known devices: ax1"),
        (["decode", "{capture}", "--out", "t.csv"], 2, "add --device NAME"),
        (["decode", "{capture}", "--device", "ax1", "--out", "t.txt"], 2, ".parquet"),
        (
            ["decode", "{capture}", "--device", "ax1", "--out", "t.csv", "--columns", "mag_q"],
            2,
            "no column mag_q",
        ),
        (["decode", "{capture}", "--device", "openimu", "--out", "t.csv"], 4, "no samples of openimu"),
        (["decode", "nothing.raw", "--device", "ax1", "--out", "t.csv"], 4, "there is no such file"),
        (["decode", ".", "--device", "ax1", "--out", "t.csv"], 4, "not a session"),
        (["replay", "{capture}"], 4, "not a session"),
        (["replay", "{session}", "--speed", "fast"], 2, "a positive number or max"),
        (["monitor", "/dev/ttyNONE", "--device", "ax1", "--view", "none"], 3, "No such file"),
        (["monitor", "/dev/ttyNONE", "--device", "{bad}"], 2, "bad.yaml:3:"),
        (["import", "{capture}", "--map", "none.yaml", "--out", "s"], 2, "none.yaml"),
        (["detect", "/dev/ttyNONE", "--seconds", "0.2"], 3, "No such file"),
        (["devices", "ax9"], 2, "no device 'ax9'"),
        (["virtual", "--rate", "1000"], 2, "of a line at 115200 baud"),
        (["virtual", "--rate", "nan"], 2, "is not a number"),
        (["virtual", "--seconds", "inf"], 2, "is not in the range"),
        (["virtual", "--seed", "-1"], 2, "is not in the range"),
        (["virtual", "--link", "bad.yaml", "--seconds", "1"], 2, "exists already"),
        (["virtual", "--link", "none/ahrs", "--seconds", "1"], 2, "cannot be made"),
        (["monitor", "{capture}", "--device", "ax1", "--seconds", "nan"], 2, "is not a number"),
        (["monitor", "\udcff", "--device", "ax1", "--view", "none"], 2, "not plain text"),
        (["detect", "/dev/ttyNONE", "--seconds", "-1"], 2, "is not in the range"),
        (["decode", "n" * 300, "--device", "ax1", "--out", "t.csv"], 2, "File name too long"),
        (["decode", "/dev/null", "--device", "ax1", "--out", "t.csv"], 4, "is not a session"),
        (["decode", "{capture}", "--device", "ax1", "--out", "none/t.csv"], 2, "there is no folder"),
        (["export", "nothing", "--to", "csv"], 4, "there is no such file or folder"),
        (["export", "{capture}", "--to", "csv"], 4, "not a session"),
        (["import", "{capture}", "--map", "{map}", "--out", "."], 2, "give the name of a new folder"),
        (
            ["import", "{capture}", "--map", "none.yaml", "--out", "s"],
            2,
            "imumon import --help has an example",
        ),
        (["replay", "{session}", "--pipeline", "{map}"], 2, "keys that there are: format, latitude_deg"),
        (["replay", "{session}", "--pipeline", "{tab}"], 2, "YAML is indented with spaces"),
        (["view", "{session}", "--out", "v.html"], 2, "name it v.rrd"),
        (["simulate", "kitchen", "--out", "s.xlsx"], 2, "a table is NAME.parquet or NAME.csv"),
        (["simulate", "kitchen", "--out", "s.CSV"], 2, "a table is NAME.parquet or NAME.csv"),
        (["simulate", "kitchen", "--out", "s.csv", "--serial", "S1"], 2, "a table has no serial number"),
        (["simulate", "kitchen", "--out", "s", "--duration", "10m"], 2, "10m is not a number of seconds"),
        (["monitor", ".", "--device", "ax1", "--view", "none"], 3, "it exists but is not a serial port"),
        (["demo", "--speed"], 2, "Usage: imumon demo"),
        (["demo", "--seconds", "fast"], 2, "Usage: imumon demo"),
        (["frobnicate"], 2, "No such command"),
        (["monitr"], 2, "Did you mean 'monitor'?"),
        (["monitor"], 2, "Missing argument"),
    ],
)
def test_wrong_input_gets_one_clear_error_and_writes_nothing(
    arguments: list[str], code: int, words: str, capture: Path, session: Path, tmp_path: Path
) -> None:
    bad = tmp_path / "bad.yaml"
    bad.write_text("format: imumon-device/1\nname: bad\nprotocol: fixd\n")
    table_map, tab = capture.with_name("map.yaml"), capture.with_name("tab.yaml")
    table_map.write_text("rate_hz: 100\ngyro: {columns: [x, y, z], unit: deg/s}\n")
    tab.write_text("rest:\n\tminimum_s: 3\n")
    places = {
        "{capture}": str(capture),
        "{session}": str(session),
        "{bad}": str(bad),
        "{map}": str(table_map),
        "{tab}": str(tab),
    }
    done = imumon(*(places.get(argument, argument) for argument in arguments), cwd=tmp_path)
    assert done.returncode == code, done.stderr
    assert words in done.stderr
    assert "Traceback" not in done.stderr
    assert done.stdout == ""
    assert [path.name for path in tmp_path.iterdir()] == ["bad.yaml"]


def test_detect_finds_device_and_baud_rate(tmp_path: Path) -> None:
    with VirtualDevice(load_device("ax1"), tmp_path / "ahrs") as ahrs:
        devices, rates = ("--device", "ax1", "--device", "openimu"), ("--baud", 57600, "--baud", 115200)
        result = answer("detect", ahrs.port.path, *devices, *rates, "--seconds", 1)
    assert result["found"] == {"device": "ax1", "baudrate": 115200}
    assert {row["verdict"] for row in result["evidence"]} >= {"frames", "does not frame"}


def test_a_device_file_can_be_printed_changed_and_used(capture: Path, tmp_path: Path) -> None:
    mine = tmp_path / "mine.yaml"
    mine.write_text(imumon("devices", "ax1").stdout.replace("name: ax1", "name: mine"))
    result = answer("decode", capture, "--device", mine, "--out", tmp_path / "t.csv")
    assert result["packets_by_type"] == {"mine": 197}
    assert set(answer("devices")) >= {"ax1", "openimu", "xsens"}
    assert isinstance(answer("ports")["ports"], list)


def test_a_silent_port_is_an_error_with_a_session_of_what_happened(tmp_path: Path) -> None:
    port = FaultyPort(tmp_path / "ahrs")
    with VirtualDevice(load_device("ax1"), port=port) as ahrs:
        port.silence()
        done = imumon(*monitoring(ahrs, tmp_path / "s"), "--seconds", 1)
    assert done.returncode == 3
    assert "no byte came" in done.stderr
    assert (tmp_path / "s" / "session.yaml").exists()


def shell(line: str, cwd: Path) -> subprocess.CompletedProcess[str]:
    """Run a line of bash in which imumon is the command under test."""
    script = f'set -o pipefail; imumon() {{ "{IMUMON}" "$@"; }}; {line}'
    return subprocess.run(
        ["bash", "-c", script], capture_output=True, text=True, timeout=LIMIT_S, cwd=cwd, check=False
    )


@pytest.mark.long
@pytest.mark.parametrize("redirection", ["2>/dev/full", ">&- 2>&- <&-", "2> >(head -c 1 >/dev/null)"])
def test_a_recording_does_not_depend_on_who_reads_its_messages(tmp_path: Path, redirection: str) -> None:
    with VirtualDevice(load_device("ax1"), tmp_path / "ahrs"):
        done = shell(
            f"imumon monitor ahrs --device ax1 --view none --out s --seconds 1.5 {redirection}", tmp_path
        )
    assert done.returncode == 0
    result = answer("replay", tmp_path / "s")
    assert result["identical_to_live"] is True
    assert result["packets"] > 100


def test_output_that_nobody_takes_is_an_error_without_a_traceback(session: Path, tmp_path: Path) -> None:
    full = shell("imumon devices > /dev/full", tmp_path)
    assert (full.returncode, full.stdout) == (2, "")
    assert full.stderr == "imumon: No space left on device\nmake room, or give a place on another disk\n"
    assert shell("imumon --help > /dev/full", tmp_path).returncode == 2
    piped = shell(f"imumon replay {session} --json | true", tmp_path)
    assert piped.returncode == 0
    assert "rror" not in piped.stderr.replace("errors", "")


def test_output_that_has_no_letter_for_a_sign_is_written_all_the_same() -> None:
    command, latin = [IMUMON, "catalog", "--help"], os.environ | {"PYTHONIOENCODING": "latin-1"}
    done = subprocess.run(command, capture_output=True, env=latin, check=False, timeout=LIMIT_S)
    assert done.returncode == 0, done.stderr
    assert b"temperatures, \\u03c3, losses" in done.stdout


def test_the_recording_of_a_session_is_no_raw_capture(tmp_path: Path) -> None:
    answer("simulate", "bench", "--out", tmp_path / "s", "--duration", 1)
    told = answer("decode", tmp_path / "s" / "wire.mcap", "--device", "ax1", "--out", tmp_path / "t.csv")
    assert (told["samples"], told["bytes_skipped"]) == (100, 0)


def test_a_table_never_replaces_what_it_is_made_from(capture: Path, tmp_path: Path) -> None:
    (tmp_path / "log.csv").write_text("x,y,z\n1,2,3\n4,5,6\n")
    (tmp_path / "map.yaml").write_text("rate_hz: 100\ngyro: {columns: [x, y, z], unit: deg/s}\n")
    answer("import", tmp_path / "log.csv", "--map", tmp_path / "map.yaml", "--out", tmp_path / "s")
    truth = tmp_path / "s" / "samples.parquet"
    raw = tmp_path / "capture.csv"
    raw.write_bytes(capture.read_bytes())
    before = truth.read_bytes()
    for arguments in (
        ["export", tmp_path / "s", "--to", "parquet", "--columns", "gyro_x", "--out", truth],
        ["replay", tmp_path / "s", "--out", truth],
        ["decode", tmp_path / "s", "--out", truth],
        ["decode", raw, "--device", "ax1", "--out", raw],
    ):
        done = imumon(*arguments)
        assert done.returncode == 2
        assert "is what is read" in done.stderr
    assert truth.read_bytes() == before
    assert raw.read_bytes() == capture.read_bytes()


def test_a_session_may_be_named_by_its_yaml_also_for_export(session: Path, tmp_path: Path) -> None:
    copy = tmp_path / "copy"
    copy.mkdir()
    for name in ("session.yaml", "wire.mcap"):
        (copy / name).write_bytes((session / name).read_bytes())
    assert answer("export", copy / "session.yaml", "--to", "csv")["out"] == str(copy / "export.csv")


def test_a_capture_is_decoded_from_a_pipe(capture: Path, tmp_path: Path) -> None:
    with subprocess.Popen(["cat", capture], stdout=subprocess.PIPE) as cat:
        assert cat.stdout is not None
        pipe = f"/dev/fd/{cat.stdout.fileno()}"
        assert answer("decode", pipe, "--device", "ax1", "--out", tmp_path / "t.csv")["packets"] == 197


@pytest.fixture
def _heeded_hangup() -> Iterator[None]:
    """Let child processes heed a hang-up, even where the tests themselves run under nohup."""
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)
    yield
    signal.signal(signal.SIGHUP, before)


@pytest.mark.usefixtures("_heeded_hangup")
@pytest.mark.parametrize(
    ("before", "ignored", "number"),
    [((), (), signal.SIGHUP), (("nohup",), (signal.SIGHUP,), signal.SIGTERM)],
)
def test_a_kill_and_a_closed_terminal_end_the_monitor_in_order_but_not_under_nohup(
    tmp_path: Path, before: Sequence[str], ignored: Sequence[signal.Signals], number: signal.Signals
) -> None:
    with VirtualDevice(load_device("ax1"), tmp_path / "ahrs") as ahrs:
        child = started(ahrs, tmp_path / "s", before)
        size = wait_for_bytes(tmp_path / "s")
        for harmless in ignored:
            child.send_signal(harmless)
            wait_for_bytes(tmp_path / "s", size + 10_000)
            assert child.poll() is None
        child.send_signal(number)
        out, err = child.communicate(timeout=LIMIT_S)
    assert child.returncode == 0, err
    assert json.loads(out)["packets"] > 50
    assert "imumon replay" in err
    assert answer("replay", tmp_path / "s")["identical_to_live"] is True


@pytest.mark.long
def test_two_monitors_started_at_once_get_sessions_of_their_own(tmp_path: Path) -> None:
    with VirtualDevice(load_device("ax1"), tmp_path / "a"), VirtualDevice(load_device("ax1"), tmp_path / "b"):
        command = [IMUMON, "monitor", "--device", "ax1", "--view", "none", "--seconds", "1.5", "--json"]
        children = [
            subprocess.Popen(
                [*command, str(tmp_path / name)], cwd=tmp_path, stdout=subprocess.PIPE, text=True
            )
            for name in ("a", "b")
        ]
        results = [json.loads(child.communicate(timeout=LIMIT_S)[0]) for child in children]
    assert [child.returncode for child in children] == [0, 0]
    assert len({result["session"] for result in results}) == 2
    for result in results:
        assert answer("replay", tmp_path / result["session"])["identical_to_live"] is True


def test_a_virtual_device_whose_values_do_not_fit_reports_it(tmp_path: Path) -> None:
    (tmp_path / "odd.yaml").write_text(
        "format: imumon-device/1\nname: odd\ntitle: Odd\nprotocol: fixed\naxes: FRD\nrate_hz: 50\n"
        "packet:\n  length: 4\n  byte_order: big\n  sync: [0xAA]\n"
        "  checksum: {type: sum8, first: 0, last: 2, at: 3}\n"
        "  fields: [{at: 1, type: u8, column: gyro_x, scale: 1.0e-6, unit: deg/s}]\n"
    )
    done = imumon("virtual", "--device", tmp_path / "odd.yaml", "--seconds", 20)
    assert done.returncode == 4
    assert "179420 does not fit" in done.stderr
    assert "Traceback" not in done.stderr


def test_what_a_library_made_of_ctrl_c_is_no_defect(monkeypatch: pytest.MonkeyPatch) -> None:
    def validate() -> None:
        try:
            signal.raise_signal(signal.SIGINT)
        except KeyboardInterrupt as error:
            lost = f"SchemaError: {type(error).__name__}"
        raise RuntimeError(lost)

    monkeypatch.setattr(cli, "INTERRUPTED", threading.Event())
    command = click.Command("ports", callback=validate)
    monkeypatch.setattr(type(cli.cli), "get_command", lambda *_: command)
    before = signal.signal(signal.SIGINT, cli._interrupt)
    try:
        assert cli.run(["ports"]) == EXIT_INTERRUPTED
    finally:
        signal.signal(signal.SIGINT, before)


def test_a_ctrl_c_that_a_library_lost_ends_a_command_that_waits_for_one(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    before = {number: signal.getsignal(number) for number in ending_signals()}
    interrupted = threading.Event()
    monkeypatch.setattr("imumon.cli.live_run.INTERRUPTED", interrupted)
    try:
        assert Ending(None).wait()
        interrupted.set()
        assert not Ending(None).wait()
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def test_a_view_that_is_still_drawn_ends_with_the_command() -> None:
    still_drawing = (
        "import sys, threading, time\nfrom imumon.cli import main\nfrom imumon.view import RECORDER\n"
        f"threading.Thread(target=time.sleep, args=[{10 * LIMIT_S}], name=RECORDER).start()\n"
        "sys.argv = ['imumon', '--version']\nmain()\n"
    )
    command = [sys.executable, "-c", still_drawing]
    done = subprocess.run(command, check=False, capture_output=True, timeout=LIMIT_S)
    assert done.returncode == 0
    assert done.stdout
