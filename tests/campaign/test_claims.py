from __future__ import annotations

import os
import subprocess
import sys
import time
from dataclasses import replace

import pytest

from labpipe.campaign.claims import LONGEST, is_alive, own_claim


def test_this_process_lives() -> None:
    assert is_alive(own_claim())


@pytest.mark.skipif(sys.platform == "win32", reason="POSIX alone keeps what has ended")
def test_a_process_that_ended_does_not() -> None:
    ended = subprocess.Popen([sys.executable, "-c", ""])
    os.waitid(os.P_PID, ended.pid, os.WEXITED | os.WNOWAIT)  # it is a zombie from here on
    assert not is_alive(replace(own_claim(), pid=ended.pid, process=""))
    ended.wait()
    assert not is_alive(replace(own_claim(), pid=ended.pid, process=""))


@pytest.mark.skipif(sys.platform != "linux", reason="only Linux tells when a process began")
def test_a_process_that_got_the_number_of_another_is_not_that_one() -> None:
    assert not is_alive(replace(own_claim(), process="another boot 1"))


def test_of_another_host_the_claim_must_be_young() -> None:
    other = replace(own_claim(), host="elsewhere", pid=1)
    assert is_alive(other)
    for age in (LONGEST + 1, -LONGEST - 1):  # the second: a clock that was set back
        assert not is_alive(replace(other, since=time.time() - age))
