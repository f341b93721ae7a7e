"""The tests mirror the package: `test_<module>.py` or `test_<module>_<rest>.py`, by layer."""

from __future__ import annotations

from pathlib import Path

import pytest

ELSEWHERE = {
    "cli/check.py": "cli/test_cli.py",
    "cli/inspect.py": "cli/test_cli.py",
    "cli/new.py": "cli/test_cli.py",
    # Blocks of the grammar without code of their own, and how they are told: through the loader.
    "protocol/outline.py": "protocol/test_load.py",
    "protocol/rig.py": "protocol/test_load.py",
    "protocol/steps.py": "protocol/test_load.py",
    # Its shapes, drawn end to end; its numbers, through the calibration they lay out.
    "pipeline/bent_shapes.py": "end_to_end/test_calibrate.py",
    "pipeline/calibration_json.py": "pipeline/test_calibrating.py",
    "pipeline/comparison_json.py": "pipeline/test_third_curves.py",
    # Columns of curves from elsewhere, through reading them.
    "readers/curve_columns.py": "readers/test_curve_csv.py",
    # What reading checks, through reading.
    "store/checked.py": "store/test_read.py",
    # Frozen settings; the truth that is made of them is looked at.
    "virtual_lab/cantilever_scenarios.py": "virtual_lab/test_cameras.py",
}
"""Modules of a dozen lines, and modules of data, whose tests stand together."""


def modules(repository: Path) -> list[str]:
    package = repository / "labpipe"
    return sorted(
        path.relative_to(package).as_posix()
        for path in package.rglob("*.py")
        if path.name != "__init__.py"
    )


def own_tests(repository: Path, module: str) -> set[Path]:
    """Files test_<module>.py and test_<module>_<rest>.py."""
    path = repository / "tests" / module
    return {path.with_name(f"test_{path.name}"), *path.parent.glob(f"test_{path.stem}_*.py")} & set(
        path.parent.glob("test_*.py")
    )


def test_every_module_has_its_tests(repository: Path) -> None:
    missing = []
    for module in modules(repository):
        elsewhere = ELSEWHERE.get(module)
        if not (own_tests(repository, module) or elsewhere):
            missing.append(module)
        if elsewhere and not (repository / "tests" / elsewhere).is_file():
            missing.append(f"{module} -> tests/{elsewhere}")
    assert not missing, "\n".join(missing)


def test_no_tests_of_modules_that_are_gone(repository: Path) -> None:
    known = {path for module in modules(repository) for path in own_tests(repository, module)}
    layers = {Path(module).parts[0] for module in modules(repository) if "/" in module}
    tests = repository / "tests"
    found = {path for layer in layers for path in (tests / layer).glob("test_*")}
    strays = {path.relative_to(tests).as_posix() for path in found - known}
    assert strays <= set(ELSEWHERE.values())


@pytest.mark.parametrize("module", sorted(ELSEWHERE))
def test_exceptions_are_still_needed(repository: Path, module: str) -> None:
    assert (repository / "labpipe" / module).is_file()
    assert not own_tests(repository, module)
