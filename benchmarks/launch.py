"""Run a command and print what it cost: exit status, seconds on the clock, of all processors, MB.

As a process of its own: ``python -I -S launch.py COMMAND ...``. The peak memory of a process is
never less than that of the process that started it, so that one must be small: this one is.
"""

import json
import os
import subprocess
import sys
import time

start = time.perf_counter()
process = subprocess.Popen(sys.argv[1:], stdout=subprocess.DEVNULL)
_, status, usage = os.wait4(process.pid, 0)
wall = time.perf_counter() - start
process.returncode = os.waitstatus_to_exitcode(status)
cpu, memory = usage.ru_utime + usage.ru_stime, usage.ru_maxrss / 1024.0
sys.stdout.write(json.dumps([process.returncode, wall, cpu, memory]))
