"""Exports that are links: kept within the folder of the test unless a person lets them lead out."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Final

from labpipe.errors import Fault
from labpipe.protocol.sheet import COPY_IT, TestSheet
from labpipe.protocol.yaml_text import Document

FOLLOW: Final = "follow_links"
"""Key of a protocol whose exports may be links into a store elsewhere."""
_OR_FOLLOW = (
    f" Or let links be followed: with --follow-links on the command line, or '{FOLLOW}: true' in"
    " the protocol."
)


def are_followed(protocol: Document) -> bool:
    """Tell whether a protocol, as written, lets exports be links out of the folder of the test.

    Parameters
    ----------
    protocol : without what a test changes in it: a test folder from elsewhere must not decide this
    """
    data = protocol.data if isinstance(protocol.data, Mapping) else {}
    return str(data.get(FOLLOW)).lower() == "true"


def link_faults(sheet: TestSheet, folder: Path, *, followed: bool) -> Iterator[Fault]:
    """Find exports that a link takes out of the folder of the test, or nowhere.

    Parameters
    ----------
    sheet : names the exports
    folder : of the test
    followed : whether links may lead out of it

    Returns
    -------
    Faults at the key ``files`` of the test sheet.
    """
    home = folder.resolve()
    for role, names in sheet.files.items():
        for name in names:
            try:
                is_inside = (folder / name).resolve().is_relative_to(home)
            except (OSError, RuntimeError):  # Python 3.12 and before call a loop a RuntimeError
                found = f"{name!r}, a link that leads back to itself"
                yield Fault(("files", role), "a file", found, "Make the link anew.")
                continue
            if not (is_inside or followed):
                expected = "a file inside the folder of the test"
                found = f"{name!r}, a link out of it"
                yield Fault(("files", role), expected, found, f"{COPY_IT}{_OR_FOLLOW}")
