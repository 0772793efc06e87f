"""Single keys in real terminals: in the foreground, in the background, and when the terminal is closed."""

from __future__ import annotations

import os
import pty
import subprocess
import sys

from tests.waiting import LIMIT_S

OWN = "import fcntl, termios; fcntl.ioctl(0, termios.TIOCSCTTY, 0)\n"
PRESSED = """
from imumon.cli.live_run import single_keys
import sys, time
with single_keys() as pressed:
    print("ready", pressed is not None, flush=True)
    end, found = time.monotonic() + float(sys.argv[1]), ""
    while pressed is not None and time.monotonic() < end and len(found) < 2:
        found += pressed()
        time.sleep(0.01)
    print("found", found, flush=True)
"""
IN_BACKGROUND = f"""
import subprocess, sys
done = subprocess.Popen([sys.executable, "-c", {PRESSED!r}, sys.argv[1]], process_group=0)
try:
    done.wait({LIMIT_S})
except subprocess.TimeoutExpired:
    done.kill()
    print("it was stopped")
"""


def _run(script: str, keys: bytes, close: bool = False) -> str:
    """Run a script in a terminal of its own, press keys when it is ready; return what it printed."""
    ours, theirs = pty.openpty()
    process = subprocess.Popen(
        [sys.executable, "-c", OWN + script, str(1.0 if close else LIMIT_S)],
        stdin=theirs,
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    os.close(theirs)
    assert process.stdout is not None
    with process.stdout as out:
        said = out.readline()
        os.write(ours, keys)
        if close:
            os.close(ours)
        said += out.read()
    process.wait()
    if not close:
        os.close(ours)
    return said.decode()


def test_keys_come_without_enter() -> None:
    assert _run(PRESSED, b"ms") == "ready True\nfound ms\n"


def test_a_command_in_the_background_gets_none_and_is_not_stopped() -> None:
    assert _run(IN_BACKGROUND, b"ms") == "ready False\nfound \n"


def test_a_terminal_that_is_closed_ends_nothing() -> None:
    ignoring = f"import signal; signal.signal(signal.SIGHUP, signal.SIG_IGN)\n{PRESSED}"
    assert _run(ignoring, b"", close=True) == "ready True\nfound \n"
