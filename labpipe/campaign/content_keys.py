"""Keys of the inputs of tests, without reading unchanged files.

The key of a test is that of its results (`labpipe.process.run.key_of`): exports, test sheet,
resolved protocol and processing version. A file with the size, times and inode of its last hash is
not read again, unless it may have changed within the time resolution of the file system.
"""

from __future__ import annotations

import hashlib
import json
import stat
import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import labpipe
from labpipe.errors import Fault, LabpipeError
from labpipe.process.reading import fingerprint_dialect_cards, list_named_exports
from labpipe.process.run import PROCESSING_VERSION, key_of
from labpipe.protocol.load import dump_protocol, find_protocol, load_test_sheet, resolve
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import SHEET_NAME, TestSheet
from labpipe.protocol.yaml_text import parse_yaml

_NOT_IN_PROTOCOL = {"test", "date", "operator", "files"}
"""Keys of a test sheet without influence on processing; the roles of files have some."""
_OF_SPECIMEN = {"spool", "sample", "labels"}


class Stamp(NamedTuple):
    """A hash of a file, and the state of the file at that time.

    Parameters
    ----------
    size : bytes
    modified, changed : times, ns, of the content and of anything about the file
    number : inode
    taken : time of the hash, ns
    sha256 : hexadecimal; empty for an unreadable file
    """

    size: int
    modified: int
    changed: int
    number: int
    taken: int
    sha256: str

    @property
    def is_sure(self) -> bool:
        """Return whether any later change of the file changes its state.

        False for a hash taken too soon after the last change, or before it (clock set back).
        """
        # ns: the coarsest time resolution of file systems, that of FAT
        time_resolution = 2_000_000_000
        return max(self.modified, self.changed) + time_resolution < self.taken


def stamp_of(path: Path, last: Stamp | None = None) -> Stamp:
    """Take the stamp of a file, without hashing an unchanged file again.

    Parameters
    ----------
    path : the file
    last : its last stamp

    Returns
    -------
    The stamp; without a hash for a missing or unreadable file, or anything but a plain file.
    """
    taken = time.time_ns()
    try:
        about = path.stat()
        looks = (about.st_size, about.st_mtime_ns, about.st_ctime_ns, about.st_ino)
        if last is not None and looks == last[:4] and last.is_sure:
            return last
        if not stat.S_ISREG(about.st_mode):
            return _NO_FILE
        with path.open("rb") as file:
            return Stamp(*looks, taken, hashlib.file_digest(file, "sha256").hexdigest())
    except (OSError, ValueError):  # or an impossible name
        return _NO_FILE


_NO_FILE = Stamp(-1, 0, 0, 0, 0, "")


@dataclass(frozen=True)
class Content:
    """Inputs of a test.

    Parameters
    ----------
    key : of all inputs; the `run` of results made from them
    inputs : role, file and SHA-256 of each export, and of the lab's dialect cards
    sheet, protocol : SHA-256 of the texts of test sheet and resolved protocol; empty if faulty
    stamps : of the test sheet and the exports, by file
    rests_on : hashes of everything else in the key, compared before the stamps
    about : from the test sheet: test, protocol, type, spool, sample, date, operator
    """

    key: str
    inputs: tuple[tuple[str, str, str], ...] = ()
    sheet: str = ""
    protocol: str = ""
    stamps: Mapping[str, Stamp] = field(default_factory=dict)
    rests_on: tuple[str, ...] = ()
    about: Mapping[str, str] = field(default_factory=dict)

    def as_text(self) -> str:
        """Return a text for `parse_content`."""
        return json.dumps(vars(self))


def parse_content(text: str) -> Content | None:
    """Parse the text of a content; return None for any other text.

    Parameters
    ----------
    text : of `Content.as_text`
    """
    try:
        fields = json.loads(text)
        fields["inputs"] = tuple(map(tuple, fields["inputs"]))
        fields["stamps"] = {name: Stamp(*values) for name, values in fields["stamps"].items()}
        fields["rests_on"] = tuple(fields["rests_on"])
        return Content(**fields)
    except (ValueError, TypeError, AttributeError, KeyError):
        return None


class ContentKeys:
    """Determines the inputs of tests; caches protocols during one command."""

    def __init__(self) -> None:
        self._found: dict[tuple[str, str], Path | Fault] = {}
        self._hashes: dict[Path, str] = {}
        self._resolved: dict[str, tuple[str, Protocol]] = {}
        self._cards: str | None = None

    def content_of(self, sheet_path: Path, last: Content | None = None) -> Content:
        """Determine the inputs of a test.

        Parameters
        ----------
        sheet_path : its test.yaml
        last : its last content; unchanged files are not read again

        Returns
        -------
        The content. A faulty test has a key, too, from its readable files.
        """
        folder = sheet_path.parent
        if last is None:
            return self._read_content(sheet_path, {})
        stamps = {name: stamp_of(folder / name, old) for name, old in last.stamps.items()}
        is_same = all(stamps[name].sha256 == old.sha256 for name, old in last.stamps.items())
        if is_same and last.rests_on and last.rests_on == self._dependencies(folder, last.rests_on):
            if all(stamps[name] == old for name, old in last.stamps.items()):
                return last
            return replace(last, stamps=stamps)
        return self._read_content(sheet_path, stamps)

    def _read_content(self, sheet_path: Path, stamps_before: Mapping[str, Stamp]) -> Content:
        folder = sheet_path.parent
        before = stamps_before.get
        stamps = {SHEET_NAME: stamp_of(sheet_path, before(SHEET_NAME))}
        try:
            sheet = load_test_sheet(sheet_path)
            text = sheet_path.read_text(encoding="utf-8")
        except (LabpipeError, OSError, ValueError):
            return self._unfit_content(folder, stamps, "")
        for names in sheet.files.values():
            stamps |= {name: stamp_of(folder / name, before(name)) for name in names}
        try:
            resolved, protocol = self._resolve(sheet, sheet_path, text)
            cards = fingerprint_dialect_cards(protocol)
        except LabpipeError:
            return replace(self._unfit_content(folder, stamps, sheet.protocol), about=_about(sheet))
        exports = list_named_exports(sheet, protocol)
        inputs = [(role, name, stamps[name].sha256) for role, name in exports]
        inputs += [(card.role, card.file, card.sha256) for card in cards]
        key = key_of([(role, sha256) for role, _, sha256 in inputs], text, resolved)
        rests_on = self._dependencies(folder, (sheet.protocol,))
        made_of = _sha256(text), _sha256(resolved)
        return Content(key, tuple(inputs), *made_of, stamps, rests_on, _about(sheet))

    def _unfit_content(self, folder: Path, stamps: Mapping[str, Stamp], protocol: str) -> Content:
        """Return the content of a test that cannot be processed."""
        rests_on = self._dependencies(folder, (protocol,))
        files = [[name, stamp.sha256] for name, stamp in stamps.items()]
        parts = ["unfit", files, *rests_on[1:]]
        return Content(_sha256(json.dumps(parts)), stamps=stamps, rests_on=rests_on)

    def _dependencies(self, folder: Path, wanted: tuple[str, ...]) -> tuple[str, ...]:
        """Return the protocol name, and hashes of its text, the lab's cards and the code."""
        name = wanted[0]
        return name, self._protocol_text(name, folder), self._all_cards(), _code()

    def _protocol_text(self, name: str, folder: Path) -> str:
        """Return the hash of the protocol text; empty without a protocol."""
        is_path = any(sign in name for sign in "/\\.")
        wanted = (name, str(folder) if is_path else "")
        if wanted not in self._found:
            self._found[wanted] = find_protocol(name, beside=folder)
        file = self._found[wanted]
        if isinstance(file, Fault):
            return ""
        if file not in self._hashes:
            self._hashes[file] = stamp_of(file).sha256
        return self._hashes[file]

    def _all_cards(self) -> str:
        if self._cards is None:
            from labpipe.readers.load_frame.cards import lab_card_files

            cards = [[file.name, stamp_of(file).sha256] for file in lab_card_files()]
            self._cards = _sha256(json.dumps(cards)) if cards else ""
        return self._cards

    def _resolve(self, sheet: TestSheet, sheet_path: Path, text: str) -> tuple[str, Protocol]:
        """Resolve the protocol of a test, once for all tests with the same overrides."""
        sheet_data: Any = parse_yaml(text, str(sheet_path)).data
        keys = {key: sheet_data[key] for key in sheet_data.keys() - _NOT_IN_PROTOCOL}
        specimen = keys.get("specimen") or {}
        keys["specimen"] = {key: specimen[key] for key in specimen.keys() - _OF_SPECIMEN}
        written = self._protocol_text(sheet.protocol, sheet_path.parent)
        cache_key = json.dumps([written, sorted(sheet.files), keys], sort_keys=True)
        if cache_key not in self._resolved:
            protocol = resolve(sheet, sheet_path, follow_links=True)
            self._resolved[cache_key] = dump_protocol(protocol), protocol
        return self._resolved[cache_key]


def _about(sheet: TestSheet) -> dict[str, str]:
    """Return the test facts of a test sheet."""
    specimen = sheet.specimen.record
    return {
        "test": sheet.test,
        "protocol": sheet.protocol,
        "type": specimen.type,
        "spool": specimen.spool,
        "sample": specimen.sample,
        "date": str(sheet.date or ""),
        "operator": sheet.operator or "",
    }


@cache
def _code() -> str:
    """Return the hash of the code that resolves protocols, and of the processing version."""
    package = Path(labpipe.__file__).parent
    files = sorted([*package.glob("protocol/*.py"), *package.glob("records/*.py")])
    digest = hashlib.sha256(str(PROCESSING_VERSION).encode())
    for file in [*files, package / "units.py"]:
        digest.update(file.read_bytes())
    return digest.hexdigest()


def describe_changes(
    *, inputs: Iterable[tuple[str, str, str]], sheet: str, protocol: str, now: Content
) -> str:
    """Describe what changed since a test was processed.

    Parameters
    ----------
    inputs : role, file and SHA-256 of its earlier inputs
    sheet, protocol : SHA-256 of the earlier texts; empty if not known
    now : its present content

    Returns
    -------
    A text such as ``export changed (force.mat), sheet changed``.
    """
    then = {file: sha256 for _, file, sha256 in inputs}
    files = sorted(
        {file for _, file, sha256 in now.inputs if then.get(file) != sha256}
        | then.keys() - {file for _, file, _ in now.inputs}
    )
    reasons = [f"export changed ({', '.join(files)})"] if files and then and now.inputs else []
    if not sheet or not now.sheet:
        return ", ".join(reasons) or "something changed"
    reasons += ["sheet changed"] if sheet != now.sheet else []
    reasons += ["protocol changed"] if protocol != now.protocol else []
    return ", ".join(reasons) or "newer labpipe"


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
