"""Where protocols lie: a lab's own folder first, then those that come with labpipe."""

from __future__ import annotations

import sysconfig
from pathlib import Path

from labpipe.errors import Fault
from labpipe.protocol.faults import did_you_mean, one_of

_SUFFIXES = (".yaml", ".yml")


def protocol_folders(protocols: Path | None = None) -> tuple[Path, ...]:
    """List the folders that hold protocols, in the order in which they are searched.

    Parameters
    ----------
    protocols : the lab's folder; ``protocols`` in the working folder if None

    Returns
    -------
    The lab's folder, that of a checkout, and that of an installed labpipe, as far as they exist.
    """
    own = Path("protocols") if protocols is None else protocols
    checkout = Path(__file__).resolve().parents[2] / "protocols"
    installed = Path(sysconfig.get_path("data")) / "share" / "labpipe" / "protocols"
    unique = {folder.resolve(): folder for folder in (installed, checkout, own) if folder.is_dir()}
    return tuple(reversed(unique.values()))


def known_protocols(protocols: Path | None = None) -> dict[str, Path]:
    """List the protocols that can be named, with their files.

    Parameters
    ----------
    protocols : as for `protocol_folders`
    """
    found: dict[str, Path] = {}
    for folder in protocol_folders(protocols):
        for path in sorted(folder.iterdir()):
            if path.suffix in _SUFFIXES:
                found.setdefault(path.stem, path)
    return found


def find_protocol(wanted: str, *, beside: Path, protocols: Path | None = None) -> Path | Fault:
    """Find the file of a protocol.

    Parameters
    ----------
    wanted : its name, or a path: beside the test sheet, or else from the working folder
    beside : folder of the test sheet
    protocols : as for `protocol_folders`

    Returns
    -------
    The file, or what is wrong with the key ``protocol`` of the sheet.
    """
    if wanted.endswith(_SUFFIXES) or "/" in wanted or "\\" in wanted:
        places = [beside / wanted, Path(wanted)]
        files = [place for place in places if _is_file(place)]
        remedy = f"There is none at {' or '.join(map(str, places))}."
        return files[0] if files else Fault(("protocol",), "a protocol", repr(wanted), remedy)
    known = known_protocols(protocols)
    if wanted in known:
        return known[wanted]
    expected = f"one of the protocols {one_of(wanted, known)}" if known else "a protocol"
    remedy = did_you_mean(wanted, known) or "There is no folder 'protocols' here."
    return Fault(("protocol",), expected, repr(wanted), remedy)


def _is_file(path: Path) -> bool:
    try:
        return path.is_file()
    except OSError:  # a name that is too long
        return False
