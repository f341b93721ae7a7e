"""Which wires are tested, which of them is calibrated, and what the sheet makes of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

from labpipe.errors import ProcessingError, UsageError, complaint, nearest
from labpipe.pipeline.first_loadings import FirstLoading
from labpipe.protocol.calibration_plan import CalibrationPlan
from labpipe.records.wire import WireSpec
from labpipe.wire.calibration import Wire
from labpipe.wire.from_spec import build

USUAL_SHEETS = ("wires.xlsx", "wires.csv")
"""What is looked for where no sheet is named."""


def usual_sheet() -> Path:
    """The sheet of the working folder.

    Raises
    ------
    UsageError
        If there is none.
    """
    for name in USUAL_SHEETS:
        if Path(name).is_file():
            return Path(name)
    message = complaint(
        "--wire",
        "",
        expected=f"a wire sheet, or {' or '.join(USUAL_SHEETS)} in the working folder",
        found="neither",
        remedy="Name the sheet that has the dimensions of the tested wires.",
    )
    raise UsageError(message)


def wire_to_calibrate(
    loadings: Sequence[FirstLoading], asked: CalibrationPlan, plan: Path | None
) -> str:
    """The wire of the plan, or the only one there is.

    Parameters
    ----------
    loadings : of all tests
    asked : the plan
    plan : its file, for messages

    Raises
    ------
    UsageError
        If the plan's wire has no tests, or it names none and there are several.
    """
    tested = sorted({each.curve.wire for each in loadings})
    if asked.wire is None and len(tested) == 1:
        return tested[0]
    if asked.wire in tested:
        return str(asked.wire)
    if asked.wire is None:
        found = f"tests of {len(tested)} wires: {', '.join(tested)}"
        remedy = "Name the one to calibrate, in the plan ('wire: A2'); the others are predicted."
        message = complaint(
            plan or "tests", "", expected="tests of one wire", found=found, remedy=remedy
        )
    else:
        remedy = "Name a specimen type of the tests, or give its tests, too."
        found = f"usable tests of {', '.join(nearest(asked.wire, tested))} alone"
        message = complaint(
            plan or "plan", "wire", expected=f"tests of '{asked.wire}'", found=found, remedy=remedy
        )
    raise UsageError(message)


def without_copies(
    loadings: Sequence[FirstLoading],
) -> tuple[list[FirstLoading], dict[str, str]]:
    """Take each first loading once: a copy of a test would count as one more.

    Parameters
    ----------
    loadings : of all tests

    Returns
    -------
    Those that differ, the first of its copies each, and by file why a copy was left out.
    """
    first: dict[tuple[bytes, bytes], FirstLoading] = {}
    left_out: dict[str, str] = {}
    for each in loadings:
        kept = first.setdefault((each.curve.deflection.tobytes(), each.curve.force.tobytes()), each)
        if kept is not each:
            left_out[str(each.file)] = complaint(
                each.file,
                "",
                expected="each test once",
                found=f"the same first loading as in {kept.file}",
                remedy="Leave the copy away.",
            )
    return list(first.values()), left_out


def require_known(
    loadings: Sequence[FirstLoading], specs: Mapping[str, WireSpec], wires: Path
) -> None:
    """Refuse tests of wires that the sheet does not have.

    Parameters
    ----------
    loadings : of all tests
    specs : wires of the sheet, by name
    wires : the sheet, for messages

    Raises
    ------
    UsageError
        If a wire is missing.
    """
    for wire in sorted({each.curve.wire for each in loadings} - set(specs)):
        test = next(each.curve.test for each in loadings if each.curve.wire == wire)
        message = complaint(
            wires,
            "column wire",
            expected=f"a row for '{wire}', the specimen type of test {test}",
            found=f"rows for {', '.join(nearest(wire, list(specs)))}",
            remedy="Add the wire, or call it as the tests do.",
        )
        raise UsageError(message)


def built_wire(spec: WireSpec, wires: Path) -> Wire:
    """Build a wire of the sheet.

    Parameters
    ----------
    spec : of the wire
    wires : the sheet, for messages

    Raises
    ------
    ProcessingError
        If its strands do not fit.
    """
    try:
        made = build(spec)
    except ValueError as error:
        message = complaint(
            wires,
            f"{spec.place}, wire '{spec.name}'",
            expected="a wire that can be built",
            found=f"this: {error}",
            remedy="Check its row against the wire.",
        )
        raise ProcessingError(message) from error
    return Wire(made.section, made.contacts, spec.orientation)
