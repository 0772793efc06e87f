"""``python -m imumon``: the command."""

from imumon.cli import main

main()
