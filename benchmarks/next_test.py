"""What one more test of a campaign costs, in a process that has already processed another one.

As a process of its own: ``python -P next_test.py OUT.json FIRST TEST ...``. Seconds on the clock
and of all threads for each test after the first: what is imported and built once is left out.
They go one at a time: several at once would be processes of their own, which do not count here.
"""

import json
import sys
import time
from pathlib import Path

from labpipe.cli import main

out, first, *tests = sys.argv[1:]
where = ["--no-figures", "--jobs", "1", "--out", str(Path(out).parent)]
main(["process", first, *where])
begun, busy = time.perf_counter(), time.process_time()
status = max(main(["process", test, *where]) for test in tests)
wall, cpu = (time.perf_counter() - begun) / len(tests), (time.process_time() - busy) / len(tests)
Path(out).write_text(json.dumps({"wall": wall, "cpu": cpu}), encoding="utf-8")
sys.exit(status)
