from __future__ import annotations

import pytest

from imumon.config import parse_yaml
from imumon.errors import ImumonError, Reason
from imumon.recordings.map import TableMap

GOOD = """\
time: {column: t, unit: s}
gyro: {columns: [gx, gy, gz], unit: deg/s}
accel:
  columns: [ax, ay, az]
  unit: g
mag: {columns: [mx, my, mz], unit: 1}
temperature: {columns: [temp], unit: degC}
attitude: {columns: [qw, qx, qy, qz], unit: 1}
pressure: {columns: [p], unit: hPa}
axes: FLU
csv: {delimiter: ";", skip_rows: 2}
bad_rows: drop
"""


def test_a_map_states_which_column_becomes_what() -> None:
    table_map = parse_yaml(GOOD, TableMap, "map.yaml")
    sources = {source.column: (source.target, source.unit.target) for source in table_map.sources()}
    assert sources["gy"] == ("gyro_y", "rad/s")
    assert sources["az"] == ("accel_z", "m/s^2")
    assert sources["mx"] == ("mag_x", "1")
    assert sources["temp"] == ("temperature", "degC")
    assert sources["qw"] == ("q_w", "1")
    assert sources["p"] == ("pressure", "Pa")
    assert len(sources) == 15


def test_three_temperatures_and_three_angles() -> None:
    text = (
        "rate_hz: 9\ntemperature: {columns: [a, b, c], unit: K}\nattitude: {columns: [r, p, y], unit: deg}\n"
    )
    targets = [source.target for source in parse_yaml(text, TableMap, "map.yaml").sources()]
    assert targets == ["temperature_x", "temperature_y", "temperature_z", "roll", "pitch", "yaw"]


@pytest.mark.parametrize(
    ("old", "new", "error"),
    [
        (
            "unit: deg/s",
            "unit: deg",
            r"map.yaml:2: gyro: unit 'deg' does not measure what 'rad/s' measures",
        ),
        ("  unit: g", "  unit: gram", r"map.yaml:3: accel: unit 'gram' is not known"),
        ("unit: degC", "unit: xyzzy", r"map.yaml:7: temperature: unit 'xyzzy' is not known"),
        ("unit: s", "unit: m", r"map.yaml:1: time.unit: unit 'm' does not measure"),
        ("unit: s", "unit: s, format: '%d.%m.%Y %H:%M:%S'", r"map.yaml:1: time: .*unit, or the format"),
        ("unit: s", "format: '%d.%m.%Y %Q'", r"map.yaml:1: time.format: 'Q' is a bad directive"),
        (
            "unit: s",
            "format: '%d.%m.%Y %H:%M'",
            r"map.yaml:1: time.format: a format has hours, minutes and sec",
        ),
        ("unit: s", "format: '%d.%m. %H:%M:%S'", r"map.yaml:1: time.format: .*a whole date or none"),
        ("unit: s", "format: '%Y-%m-%d %T %Z'", r"map.yaml:1: time.format: %Z: the name of a zone"),
        ("[gx, gy, gz]", "[gx, gy]", r"map.yaml:2: gyro: expected 3 columns, got 2"),
        ("[temp]", "[t1, t2]", r"map.yaml:7: temperature: expected 1 or 3 columns, got 2"),
        (
            "qz], unit: 1",
            "qz], unit: deg",
            r"map.yaml:8: attitude: a quaternion has unit 1, got 'deg'",
        ),
        ("time: ", "rate_hz: 100\ntime: ", r"map.yaml:1: .*either time.*or rate_hz.*both are there"),
        ("time: {column: t, unit: s}", "rate_hz: 0", r"map.yaml:1: rate_hz: .* greater than 0, got 0"),
        ("time: {column: t, unit: s}\n", "", r"neither is there"),
        ("axes: FLU", "axes: NED", r"map.yaml:10: axes: .*'FLU' or 'FRD', got 'NED'"),
        ("gx, gy", "ax, gy", r"column 'ax' is used more than once"),
        ("pressure:", "presure:", r"map.yaml:9: presure: unknown key"),
        ('";"', '";;"', r"map.yaml:11: csv.delimiter"),
        ("skip_rows: 2", "header: false", r"map.yaml:11: csv: a table without header needs csv.columns"),
        ("skip_rows: 2", "columns: [a, b]", r"map.yaml:11: csv: .*add header: false"),
        ("skip_rows: 2", "header: false, columns: [a, a]", r"map.yaml:11: csv: csv.columns names a more"),
        ("bad_rows: drop", "other: {v: {column: bat, unit: wibbles}}", r"map.yaml:12: other.v.unit"),
        (
            "bad_rows: drop",
            "other: {pressure: {column: q, unit: V}}",
            r"something else",
        ),
        ("bad_rows: drop", "other: {v: {column: ax, unit: V}}", r"column 'ax' is used more than once"),
        ("bad_rows: drop", "bad_rows: ignore", r"map.yaml:12: bad_rows: .*'error' or 'drop'"),
    ],
)
def test_a_wrong_map_is_refused_with_file_and_line(old: str, new: str, error: str) -> None:
    assert old in GOOD
    with pytest.raises(ImumonError, match=error) as caught:
        parse_yaml(GOOD.replace(old, new), TableMap, "map.yaml")
    assert caught.value.reason is Reason.BAD_CONFIG


def test_a_map_without_data_is_refused() -> None:
    with pytest.raises(ImumonError, match="names no data"):
        parse_yaml("rate_hz: 10\n", TableMap, "map.yaml")
