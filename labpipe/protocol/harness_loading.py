"""From YAML to a harness; apart from `protocol.load`, which every test is read by."""

from __future__ import annotations

from pathlib import Path

from labpipe.protocol.harness_file import HarnessFile
from labpipe.protocol.harness_reach import file_faults, reach_faults
from labpipe.protocol.load import checked, complaint_of
from labpipe.protocol.yaml_text import parse_yaml, read_text


def load_harness(path: Path) -> HarnessFile:
    """Read a harness: one line between its boundaries.

    Parameters
    ----------
    path : the YAML file

    Returns
    -------
    The harness, defaults filled in; its line is long enough for its boundaries.

    Raises
    ------
    ProtocolError
        If anything is wrong with it, or a file that it names is not there; the message has one line
        per fault.
    """
    document = parse_yaml(read_text(path), str(path))
    harness = checked(HarnessFile, document)
    faults = [*file_faults(harness, path), *reach_faults(harness)]
    if faults:
        raise complaint_of(list(map(document.place, faults)))
    return harness
