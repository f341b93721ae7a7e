"""Whether the tests notice a fault: each is tried in a process of its own, from memory.

No file is changed. The process is a fork of one that has collected the tests, and its functions get
the code that they have with the fault; where the fault acts as the module is imported, that is done
again. So a trial costs little more than its tests.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import os
import resource
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable, Sequence
from functools import partial
from importlib.machinery import SourceFileLoader
from pathlib import Path
from types import CodeType, FunctionType

import pytest
from _pytest.main import pytest_runtestloop

from tests.mutation.entered import PACKAGE
from tests.mutation.mutants import Mutant

SECONDS = 150
"""Of processor time that a trial may take; a fault that makes the tests wait is noticed."""
OPTIONS = (
    *("-x", "-q", "--hypothesis-seed=0"),
    *("-p", "no:randomly", "-p", "no:xdist", "-p", "no:cacheprovider", "-p", "no:pytest_cov"),
)


def in_session(files: Sequence[str], job: Callable[[pytest.Session], None]) -> None:
    """Collect tests once, and do a job where pytest would run them."""

    class Trials:
        def pytest_runtestloop(self, session: pytest.Session) -> bool:
            job(session)
            return True

    pytest.main([*OPTIONS, "-s", *files], plugins=[Trials()])


def noticed_by(mutant: Mutant, tests: Sequence[str], session: pytest.Session) -> str:
    """Name the test that notices a fault; empty where none does.

    Parameters
    ----------
    mutant : the fault
    tests : names of tests, in the order in which they are asked
    session : in which the tests were collected from the sound package
    """
    ask = _anew if mutant.is_at_import else partial(_failing, session)
    collected = {item.nodeid for item in session.items}
    asked = [name for name in tests if name in collected]
    return _apart(partial(ask, mutant, asked)) if asked else ""


def _apart(job: Callable[[], str]) -> str:
    """Run a job in a fork of this process; what it says, or how it ended."""
    with tempfile.TemporaryDirectory(prefix="trial-") as folder:
        said, wrong = Path(folder) / "said", Path(folder) / "wrong"
        child = os.fork()
        if not child:
            try:
                os.setsid()
                _quiet(Path(folder))
                said.write_text(job(), encoding="utf-8")
            except BaseException:  # noqa: BLE001  told by the parent
                wrong.write_text(traceback.format_exc(), encoding="utf-8")
            finally:
                os._exit(0)
        _, status = os.waitpid(child, 0)
        with contextlib.suppress(ProcessLookupError):
            os.killpg(child, signal.SIGKILL)  # what its tests have started
        if os.WIFSIGNALED(status):
            return f"signal {os.WTERMSIG(status)}"
        if wrong.is_file():
            raise RuntimeError(wrong.read_text(encoding="utf-8"))
        return said.read_text(encoding="utf-8")


def _quiet(folder: Path) -> None:
    """Limit this process, and send what it prints nowhere."""
    resource.setrlimit(resource.RLIMIT_CPU, (SECONDS, SECONDS + 5))
    signal.alarm(10 * SECONDS)
    os.environ |= {"HYPOTHESIS_STORAGE_DIRECTORY": str(folder / "examples"), "TMPDIR": str(folder)}
    tempfile.tempdir = str(folder)
    nowhere = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(nowhere, stream)


def _failing(session: pytest.Session, mutant: Mutant, tests: Sequence[str]) -> str:
    """The first test that fails, where the functions of the sound package get the fault."""
    _replace_code(mutant)
    first, items = _First(), {item.nodeid: item for item in session.items}
    session.config.pluginmanager.register(first)
    session.items = [items[name] for name in tests]
    with contextlib.suppress(session.Failed):
        pytest_runtestloop(session)
    session._setupstate.teardown_exact(None)
    return first.failed


def _replace_code(mutant: Mutant) -> None:
    """Give the functions of a module the code that they have with the fault."""
    codes, new = [_code(mutant)], {}
    for code in codes:  # it grows as it is gone through
        codes += [constant for constant in code.co_consts if isinstance(constant, CodeType)]
        new[code.co_qualname, code.co_firstlineno] = code
    for thing in gc.get_objects():
        if isinstance(thing, FunctionType) and thing.__code__.co_filename == codes[0].co_filename:
            thing.__code__ = new[thing.__code__.co_qualname, thing.__code__.co_firstlineno]
        elif type(thing).__name__ == "_lru_cache_wrapper":
            thing.cache_clear()


def _anew(mutant: Mutant, tests: Sequence[str]) -> str:
    """The first test that fails, where the package is imported again with the fault.

    What was imported without it is forgotten: a test that was would go on with the sound module.
    """
    for name in list(sys.modules):
        if name.partition(".")[0] in {"labpipe", "tests"} and not name.startswith("tests.mutation"):
            del sys.modules[name]
    faulty, sound = _code(mutant), SourceFileLoader.get_code

    def code_of(loader: SourceFileLoader, name: str) -> CodeType | None:
        return faulty if loader.path == faulty.co_filename else sound(loader, name)

    SourceFileLoader.get_code = code_of  # type: ignore[assignment, method-assign]
    try:
        importlib.import_module("labpipe." + mutant.module.removesuffix(".py").replace("/", "."))
    except Exception:  # noqa: BLE001  a fault may raise anything
        return "import"
    first = _First()
    pytest.main([*OPTIONS, *tests], plugins=[first])
    return first.failed


class _First:
    """Remembers the first test that fails."""

    failed = ""

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and not self.failed:
            self.failed = report.nodeid

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed and not self.failed:
            self.failed = report.nodeid


def _code(mutant: Mutant) -> CodeType:
    path = str(PACKAGE / mutant.module)
    return compile(mutant.tree, path, "exec", dont_inherit=True)
