"""The tests mirror the package: `test_<module>.py`, or `test_<module>_<part>.py`, in its folder."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import pytest

ELSEWHERE = {
    "cli/check.py": "cli/test_cli.py",
    "cli/inspect.py": "cli/test_cli.py",
    "cli/new.py": "cli/test_cli.py",
}
"""Commands of a dozen lines, whose tests stand together."""


def modules(repository: Path) -> list[Path]:
    package = repository / "labpipe"
    found = (path.relative_to(package) for path in package.rglob("*.py"))
    return sorted(path for path in found if path.name != "__init__.py")


def is_test_of(test: Path, module: Path) -> bool:
    return test.stem == f"test_{module.stem}" or test.stem.startswith(f"test_{module.stem}_")


def files_in(repository: Path, folder: Path) -> list[Path]:
    return list((repository / "tests" / folder).glob("test_*.py"))


def test_every_module_has_its_tests(repository: Path) -> None:
    missing = []
    for module in modules(repository):
        own = [test for test in files_in(repository, module.parent) if is_test_of(test, module)]
        elsewhere = ELSEWHERE.get(module.as_posix())
        if not own and not (elsewhere and (repository / "tests" / elsewhere).is_file()):
            missing.append(module.as_posix())
    assert not missing, "\n".join(missing)


def test_no_tests_of_modules_that_are_gone(repository: Path) -> None:
    known = modules(repository)
    strays = [
        test.relative_to(repository).as_posix()
        for folder in sorted({module.parent for module in known if len(module.parts) > 1})
        for test in files_in(repository, folder)
        if not any(is_test_of(test, module) for module in known if module.parent == folder)
        if test.relative_to(repository / "tests").as_posix() not in ELSEWHERE.values()
    ]
    assert not strays, "\n".join(strays)


def test_no_name_of_a_module_twice(repository: Path) -> None:
    names = Counter(module.name for module in modules(repository))
    assert not {name for name, count in names.items() if count > 1}


@pytest.mark.parametrize("module", sorted(ELSEWHERE))
def test_exceptions_are_still_needed(repository: Path, module: str) -> None:
    path = Path(module)
    assert (repository / "labpipe" / path).is_file()
    assert not any(is_test_of(test, path) for test in files_in(repository, path.parent))
