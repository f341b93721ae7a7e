"""Whether the tests notice a fault: each is tried in a process of its own, from memory.

No file is changed: the module with the fault is compiled where it is imported. The process is a
fork of one that has imported the libraries, so that a trial costs little more than its tests.
"""

from __future__ import annotations

import contextlib
import gc
import importlib
import io
import json
import os
import resource
import signal
import sys
import tempfile
import traceback
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from functools import partial
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, SourceFileLoader
from importlib.util import spec_from_file_location
from pathlib import Path
from types import CodeType, FunctionType
from typing import Any

import pytest
from _pytest.main import pytest_runtestloop

from tests.mutation.entered import KEPT, PACKAGE, REPOSITORY
from tests.mutation.mutants import LAYERS, Mutant

GOLDEN = (
    *("wires/A2-085-1", "tensile/pet-tape-1", "tensile/CT-10-1", "tensile/twist-tube-1a"),
    *("tensile/stiff-bar-1", "harness/CWB-1-1", "harness/TWB-B1-12-PVC-1"),
)
"""One test of each kind of the demo, whose numbers are compared with those that are kept."""
FOLLOWED = KEPT / "demo.lines"
SECONDS = 150
"""Of processor time that a trial may take; a fault that makes the tests wait is noticed."""
OPTIONS = (
    *("-x", "-q", "--hypothesis-seed=0"),
    *("-p", "no:randomly", "-p", "no:xdist", "-p", "no:cacheprovider", "-p", "no:pytest_cov"),
)
LIBRARIES = (
    "numpy",
    "scipy.optimize",
    "scipy.stats",
    "scipy.signal",
    "scipy.interpolate",
    "h5py",
    "pandas",
    "pydantic",
    "yaml",
    "openpyxl",
    "pint",
)


def with_libraries() -> None:
    """Import the libraries that the package rests on, once for all trials."""
    for name in LIBRARIES:
        importlib.import_module(name)


@dataclass(frozen=True)
class Demo:
    """Tests of the demo whose numbers are compared with those that are kept.

    Parameters
    ----------
    folder : of the exports of the demo
    lines : by test and module, the lines that are run as it is processed
    """

    folder: Path
    lines: Mapping[str, Mapping[str, frozenset[int]]]

    @classmethod
    def followed(cls, folder: Path) -> Demo:
        """Process each test once and see which lines run; none where the demo is not there.

        A test whose numbers are not those that are kept, without any fault, tells nothing.
        """
        if not folder.is_dir():
            return cls(folder, {})
        if not FOLLOWED.is_file():
            told = {name: json.loads(_apart(partial(_followed, name, folder))) for name in GOLDEN}
            FOLLOWED.write_text(json.dumps(told), encoding="utf-8")
        notes = json.loads(FOLLOWED.read_text(encoding="utf-8"))
        lines = {
            name: {module: frozenset(ran) for module, ran in note.items()}
            for name, note in notes.items()
        }
        return cls(folder, lines)

    def tests_of(self, mutant: Mutant) -> list[str]:
        """Names of the tests that run the statement of a mutant."""
        return [
            name
            for name, ran in self.lines.items()
            if mutant.module in ran
            and (not mutant.lines or not ran[mutant.module].isdisjoint(mutant.lines))
        ]


def in_session(files: Sequence[str], job: Callable[[pytest.Session], None]) -> None:
    """Collect tests once, and do a job where pytest would run them."""

    class Trials:
        def pytest_runtestloop(self, session: pytest.Session) -> bool:
            job(session)
            return True

    pytest.main([*OPTIONS, "-s", *files], plugins=[Trials()])


def noticed_by(
    mutant: Mutant, tests: Sequence[str], demo: Demo, session: pytest.Session | None
) -> str:
    """What notices a fault; empty where nothing does.

    Parameters
    ----------
    mutant : the fault
    tests : names of tests, in the order in which they are asked; then the numbers of the demo are
    demo : what to compare
    session : in which the tests are collected; none where the package is to be imported anew
    """
    ask = partial(_failing, mutant, tests, session) if session else partial(_anew, mutant, tests)
    found = _apart(ask) if tests else ""
    if not found and (names := demo.tests_of(mutant)):
        found = _apart(partial(_changed, mutant, demo.folder, names))
    return found


def _followed(name: str, folder: Path) -> str:
    """Lines that run as a test of the demo is processed, by module; none if it is not as kept."""
    from coverage import Coverage

    from tests.golden.differences import differences

    following = Coverage(data_file=None, include=[f"{PACKAGE}/{layer}/*" for layer in LAYERS])
    with following.collect():
        kept, made = golden_rows(name, folder)
    if differences(kept, made):
        return json.dumps({})
    data = following.get_data()
    found = {
        str(Path(path).relative_to(PACKAGE)): data.lines(path) for path in data.measured_files()
    }
    return json.dumps(found)


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


def _failing(mutant: Mutant, tests: Sequence[str], session: pytest.Session) -> str:
    """The first test that fails, of those that a session has collected from the sound package."""
    _replace_code(mutant)
    first, items = _First(), {item.nodeid: item for item in session.items}
    session.config.pluginmanager.register(first)
    session.items = [items[name] for name in tests if name in items]
    with contextlib.suppress(session.Failed):
        pytest_runtestloop(session)
    session._setupstate.teardown_exact(None)
    return first.failed


def _replace_code(mutant: Mutant) -> None:
    """Give the functions of a module the code that they have with the fault."""
    path = str(PACKAGE / mutant.module)
    codes, new = [compile(mutant.tree, path, "exec", dont_inherit=True)], {}
    for code in codes:  # it grows as it is gone through
        codes += [constant for constant in code.co_consts if isinstance(constant, CodeType)]
        new[code.co_qualname, code.co_firstlineno] = code
    for thing in gc.get_objects():
        if isinstance(thing, FunctionType) and thing.__code__.co_filename == path:
            thing.__code__ = new[thing.__code__.co_qualname, thing.__code__.co_firstlineno]
        elif type(thing).__name__ == "_lru_cache_wrapper":
            thing.cache_clear()


def _anew(mutant: Mutant, tests: Sequence[str]) -> str:
    """The first test that fails, all being imported anew."""
    if not _is_imported(mutant):
        return "import"
    first = _First()
    pytest.main([*OPTIONS, *tests], plugins=[first])
    return first.failed


def _changed(mutant: Mutant, demo: Path, names: Sequence[str]) -> str:
    """The first number of the demo that is not as it is kept."""
    if not _is_imported(mutant):
        return "import"
    from tests.golden.differences import differences

    for name in names:
        try:
            old, new = golden_rows(name, demo)
        except Exception as error:  # noqa: BLE001  a fault may raise anything
            return f"golden {name}: {type(error).__name__}"
        if found := differences(old, new):
            return f"golden {name}: {found[0].row.name} {found[0].field}"
    return ""


def _is_imported(mutant: Mutant) -> bool:
    """Import the module with the fault; whether that goes well.

    What was imported without it is forgotten: a test that was would go on with the sound module.
    """
    for name in list(sys.modules):
        if name.partition(".")[0] in {"labpipe", "tests"} and not name.startswith("tests.mutation"):
            del sys.modules[name]
    sys.meta_path.insert(0, _Faulty(mutant))
    try:
        importlib.import_module(_dotted(mutant.module))
    except Exception:  # noqa: BLE001  a fault may raise anything
        return False
    return True


def golden_rows(name: str, demo: Path) -> tuple[list[Any], list[Any]]:
    """Rows of a test of the demo: those that are kept, and those of the package as it is now."""
    from labpipe.process.run import process_test
    from tests.golden.rows import read, rows

    campaign, test = name.split("/")
    kept = read(REPOSITORY / "tests" / "golden" / f"{campaign}.csv")
    with tempfile.TemporaryDirectory() as folder, contextlib.redirect_stdout(io.StringIO()):
        done = process_test(demo / name / "test.yaml", out=Path(folder), figures=False)
        return [row for row in kept if row.test == test], rows(test, done.folder)


class _First:
    """Remembers the first test that fails."""

    failed = ""

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        if report.failed and not self.failed:
            self.failed = report.nodeid

    def pytest_collectreport(self, report: pytest.CollectReport) -> None:
        if report.failed and not self.failed:
            self.failed = report.nodeid


class _Faulty(MetaPathFinder):
    """Finds the module with the fault, and nothing else."""

    def __init__(self, mutant: Mutant) -> None:
        self.mutant = mutant

    def find_spec(self, name: str, *_: object) -> ModuleSpec | None:
        if name != _dotted(self.mutant.module):
            return None
        path = PACKAGE / self.mutant.module
        packages = [str(path.parent)] if path.name == "__init__.py" else None
        loader = _Loader(name, str(path))
        loader.mutant = self.mutant
        return spec_from_file_location(
            name, path, loader=loader, submodule_search_locations=packages
        )


class _Loader(SourceFileLoader):
    mutant: Mutant

    def get_code(self, fullname: str) -> CodeType:  # noqa: ARG002
        return compile(self.mutant.tree, self.path, "exec", dont_inherit=True)


def _dotted(module: str) -> str:
    return "labpipe." + module.removesuffix(".py").removesuffix("/__init__").replace("/", ".")
