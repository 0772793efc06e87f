import tempfile
from pathlib import Path
from tests.faults.killed import kill_many

for hz in (100.0, 1000.0):
    with tempfile.TemporaryDirectory() as f:
        print(kill_many(Path(f), hz, 10, 1), flush=True)
