"""What one more test of a campaign costs, in a process that has already processed another one.

As a process of its own: ``python -P next_test.py OUT.json FIRST TEST ...``. Seconds on the clock
and of all threads for each test after the first: what is imported and built once is left out, and
so is the command line. They go one at a time, as in one worker process of a campaign.
"""

import json
import sys
import time
from pathlib import Path

from labpipe.process.run import ProcessedTest, Task, try_to_process

out, *folders = sys.argv[1:]
tasks = [
    Task(Path(folder, "test.yaml"), Path(out).parent / Path(folder).name, figures=False)
    for folder in folders
]
attempts = [try_to_process(tasks[0])]
begun, busy = time.perf_counter(), time.process_time()
attempts += [try_to_process(task) for task in tasks[1:]]
count = len(tasks) - 1
wall, cpu = (time.perf_counter() - begun) / count, (time.process_time() - busy) / count
Path(out).write_text(json.dumps({"wall": wall, "cpu": cpu}), encoding="utf-8")
sys.exit(not all(isinstance(result, ProcessedTest) for result in attempts))
