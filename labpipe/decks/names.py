"""Names of wires as each program and each file system takes them."""

from __future__ import annotations

import re
import unicodedata
import zlib

ABAQUS_MOST = 80
"""Characters of an Abaqus label (Abaqus Analysis User's Guide, input syntax rules)."""
ANSYS_MOST = 8
"""Characters of the name of an Ansys section (``SECTYPE``)."""
COMMENT_MOST = 32
"""Characters of a wire's name in a comment of an Ansys deck."""
FILE_MOST = 100
"""Characters of a file's name without its ending."""

_SUM = 8  # hexadecimal digits of the check sum


def abaqus_label(name: str) -> str:
    """Label of an element set: begins with a letter, then letters, digits, ``_``, ``-``.

    Parameters
    ----------
    name : of the wire, any text

    Returns
    -------
    The name if it is a label already. Else what is left of it, with a check sum of the name, so
    that labels of different names stay different.

    Notes
    -----
    Abaqus takes labels without quotes in any case for the same: wires whose names differ in nothing
    else need names of their own.

    Examples
    --------
    >>> abaqus_label("FLRY-B_0.35")
    'FLRY-B_0_35_f1a89d0a'
    """
    return _reduced(name, allowed="A-Za-z0-9_-", first="A-Za-z", most=ABAQUS_MOST)


def ansys_name(name: str) -> str:
    """Name of a section: at most eight letters and digits, the first a letter.

    Parameters
    ----------
    name : of the wire, any text

    Returns
    -------
    The name if it will do, else what is left of it. It only labels: sections go by their number,
    so that it need not be the only one of its kind.

    Examples
    --------
    >>> ansys_name("FLRY-B 0.35")
    'FLRYB035'
    """
    left = re.sub(r"[^A-Za-z0-9]", "", _plain(name))
    return (left if left[:1].isalpha() else f"W{left}")[:ANSYS_MOST]


def file_stem(name: str) -> str:
    """Name of a file without its ending, for every common file system.

    Parameters
    ----------
    name : of the wire, any text

    Returns
    -------
    The name if it will do, else what is left of it with a check sum of the name.

    Examples
    --------
    >>> file_stem("A2")
    'A2'
    """
    kept = _reduced(name, allowed="A-Za-z0-9._ +-", first="A-Za-z0-9", most=FILE_MOST)
    is_device = re.fullmatch(r"(con|prn|aux|nul|com\d|lpt\d)(\..*)?", kept, flags=re.IGNORECASE)
    return _summed(name, kept, FILE_MOST) if is_device or kept != kept.rstrip(". ") else kept


def on_one_line(name: str, most: int) -> str:
    """A name for a comment: printable ASCII on one line, cut short with dots.

    Parameters
    ----------
    name : of the wire, any text
    most : characters, at least 4

    Examples
    --------
    >>> on_one_line("a name that goes on and on", 12)
    'a name th...'
    """
    line = re.sub(r"[^ -~]+", "?", _plain(" ".join(name.split())))
    return line if len(line) <= most else line[: most - 3] + "..."


def _reduced(name: str, *, allowed: str, first: str, most: int) -> str:
    kept = re.sub(rf"[^{allowed}]+", "_", _plain(name))
    if not re.match(f"[{first}]", kept):
        kept = f"W{kept}"
    return kept if kept == name and len(kept) <= most else _summed(name, kept, most)


def _summed(name: str, kept: str, most: int) -> str:
    total = f"{zlib.crc32(name.encode('utf-8', 'surrogatepass')):0{_SUM}x}"
    return f"{kept[: most - _SUM - 1].rstrip('. ')}_{total}"


def _plain(name: str) -> str:
    """Letters without their accents, as far as there are such."""
    parts = unicodedata.normalize("NFKD", name)
    return "".join(part for part in parts if not unicodedata.combining(part))
