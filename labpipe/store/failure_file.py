"""Writing of failure.json: the reason why a test has no new results."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass, field
from pathlib import Path

from labpipe import __version__
from labpipe.records.result import InputFile
from labpipe.store.replace import locked, replacing

FAILURE_FILE = "failure.json"
FAILURE_SCHEMA = 1


@dataclass(frozen=True, slots=True)
class FailedTest:
    """A test that could not be processed, and the reason.

    Parameters
    ----------
    test : its name; empty if unknown
    code : see `labpipe.errors.CODES`
    reason : the message for the user
    run : key of the failed run; empty if unknown
    inputs : the exports, if all can be read
    made_of : SHA-256 of the test sheet and of the resolved protocol, as in ``summary.json``; empty
        if they cannot be read
    """

    test: str
    code: str
    reason: str
    run: str = ""
    inputs: tuple[InputFile, ...] = ()
    made_of: Mapping[str, str] = field(default_factory=dict)


def write_failure(failure: FailedTest, folder: Path) -> None:
    """Write ``failure.json``; other files in the folder are unchanged.

    Parameters
    ----------
    failure : of the test
    folder : of its results; created if it does not exist

    Raises
    ------
    StoreError
        If it cannot be written, or another labpipe process works in the folder.
    """
    inputs = [{"role": i.role, "file": i.file, "sha256": i.sha256} for i in failure.inputs]
    head = {"schema": FAILURE_SCHEMA, "labpipe": __version__}
    text = json.dumps(head | asdict(failure) | {"inputs": inputs}, indent=2, ensure_ascii=False)
    with locked(folder), replacing(folder / FAILURE_FILE) as temporary:
        temporary.write_bytes(f"{text}\n".encode("utf-8", "backslashreplace"))
