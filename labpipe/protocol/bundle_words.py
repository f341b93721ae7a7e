"""A harness bundle in the words of the command line, read by the grammar of the test sheet."""

from __future__ import annotations

from pydantic import ValidationError

from labpipe.errors import Fault, UsageError, complaint
from labpipe.protocol.bundle import SheetBundle
from labpipe.protocol.faults import faults_of
from labpipe.records.bundle import PACKED, Bundle


def bundle_in_words(words: str, *, arrangement: str = PACKED) -> Bundle:
    """Read a bundle such as ``10 B1 + 9 B2``.

    Parameters
    ----------
    words : numbers and types of the wires, with a diameter in brackets where one is known
    arrangement : one of `labpipe.records.bundle.ARRANGEMENTS`

    Returns
    -------
    The bundle, without tape and conduit.

    Raises
    ------
    UsageError
        If the words are not those of a bundle, or have no such arrangement.
    """
    data = {"wires": words, "arrangement": arrangement}
    try:
        return SheetBundle.model_validate(data).record
    except ValidationError as error:
        faults = faults_of(error, data=data, keys=())
        raise UsageError("\n".join(_told(fault, words) for fault in faults)) from None


def _told(fault: Fault, words: str) -> str:
    place = "" if fault.path == ("wires",) else ".".join(map(str, fault.path))
    remedy = fault.remedy or "Write it like '10 B1 + 9 B2 (1.25 mm)', or give a test.yaml."
    return complaint(words, place, expected=fault.expected, found=fault.found, remedy=remedy)
