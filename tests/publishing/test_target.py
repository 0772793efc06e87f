from __future__ import annotations

import importlib.util

import pytest

from imumon.errors import ImumonError, Reason
from imumon.publishing.target import Target, parse_target


@pytest.fixture
def everything_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: object())


@pytest.fixture
def nothing_installed(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda _: None)


@pytest.mark.usefixtures("everything_installed")
@pytest.mark.parametrize(
    ("text", "target"),
    [
        ("udp-json", Target("udp-json", "127.0.0.1", 9870)),
        ("foxglove", Target("foxglove", "127.0.0.1", 8765)),
        ("ros2", Target("ros2", "127.0.0.1")),
        ("udp-json=:4000", Target("udp-json", "127.0.0.1", 4000)),
        ("udp-json=127.0.0.2", Target("udp-json", "127.0.0.2", 9870)),
        ("foxglove=[::1]:80", Target("foxglove", "::1", 80)),
        ("foxglove=[::1]", Target("foxglove", "::1", 8765)),
    ],
)
def test_without_an_address_beyond_it_nothing_leaves_this_computer(text: str, target: Target) -> None:
    found = parse_target(text)
    assert found == target
    assert parse_target(str(found)) == found
    assert found.is_local
    assert found.warning is None


@pytest.mark.usefixtures("everything_installed")
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("udp-json=192.0.2.7:4000", "go to 192.0.2.7"),
        ("udp-json=[2001:db8::1]:4000", "go to 2001:db8::1"),
        ("foxglove=0.0.0.0", "every computer that reaches this one"),
        ("foxglove=[::]:80", "every computer that reaches this one"),
        ("ros2=network", "every computer that reaches this one"),
    ],
)
def test_what_leaves_this_computer_is_reported(text: str, said: str) -> None:
    found = parse_target(text)
    assert not found.is_local
    assert said in (found.warning or "")
    assert parse_target(str(found)) == found


@pytest.mark.usefixtures("everything_installed")
@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("udp", "there is no 'udp'"),
        ("", "there is no ''"),
        ("udp-json=here:65536", "out of range"),
        ("udp-json=127.0.0.1:x", "'x'"),
        ("foxglove=::1", "':1'"),
        ("udp-json=no such host:5", "not known"),
        ("udp-json=9999", "no host and port"),
        ("foxglove=8766", "no host and port"),
        ("udp-json=127.0.0.1:0", "no host and port"),
        ("udp-json=127.0.0.1:98/x", "no host and port"),
        ("udp-json=a@127.0.0.1:98", "no host and port"),
        ("udp-json=[fe80::1%lo]:98", "no host and port"),
        ("ros2=192.0.2.7", "takes no address"),
    ],
)
def test_what_cannot_be_read_is_refused(text: str, said: str) -> None:
    with pytest.raises(ImumonError, match="--publish") as error:
        parse_target(text)
    assert said in error.value.seen
    assert error.value.reason is Reason.BAD_CONFIG
    assert error.value.hint


@pytest.mark.usefixtures("nothing_installed")
def test_what_is_missing_is_named_with_where_it_comes_from() -> None:
    assert parse_target("udp-json").kind == "udp-json", "it needs nothing"
    with pytest.raises(ImumonError, match=r"foxglove-sdk\n.*imumon\[foxglove\]"):
        parse_target("foxglove")
    with pytest.raises(ImumonError, match=r"rclpy.*\n.*setup.bash"):
        parse_target("ros2")
