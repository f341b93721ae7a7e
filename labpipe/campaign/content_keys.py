"""What a test is made of, told without reading what has not changed.

The key of a test is that of its results (`labpipe.process.run.key_of`): exports, test sheet,
resolved protocol and processing version. A file whose size, times and number are those it had when
its hash was taken is not read again, unless it could have changed within the same tick of a clock.
"""

from __future__ import annotations

import hashlib
import json
import stat
import time
from collections.abc import Iterable, Mapping
from dataclasses import astuple, dataclass, field, replace
from functools import cache
from pathlib import Path
from typing import Any

import labpipe
from labpipe.errors import Fault, LabpipeError
from labpipe.process.reading import cards_in_play, named_exports
from labpipe.process.run import PROCESSING_VERSION, key_of
from labpipe.protocol.load import dump_protocol, find_protocol, load_test_sheet, resolve
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import SHEET_NAME, TestSheet
from labpipe.protocol.yaml_text import parse_yaml

_TICK = 2_000_000_000
"""ns: the coarsest tick in which file systems count times, that of FAT."""
_NOT_IN_PROTOCOL = ("test", "date", "operator", "files")
"""Keys of a test sheet that say nothing of how the test is processed; roles of files do."""
_OF_SPECIMEN = ("spool", "sample", "labels")


@dataclass(frozen=True, slots=True)
class Stamp:
    """How a file looked when its hash was taken.

    Parameters
    ----------
    size : bytes
    modified, changed : times, ns, of the content and of anything about the file
    number : of the file on its disk
    taken : when the hash was, ns
    sha256 : hexadecimal; empty for a file that could not be read
    """

    size: int
    modified: int
    changed: int
    number: int
    taken: int
    sha256: str

    @property
    def looks(self) -> tuple[int, int, int, int]:
        """What is compared."""
        return self.size, self.modified, self.changed, self.number

    @property
    def is_sure(self) -> bool:
        """Whether a later change must have changed its looks.

        Not where it was hashed within a tick of its last change, or before it: then clocks were
        set back.
        """
        return max(self.modified, self.changed) + _TICK < self.taken


def stamp_of(path: Path, known: Stamp | None = None) -> Stamp:
    """Take the stamp of a file; its hash only where it is in doubt.

    Parameters
    ----------
    path : the file
    known : its last stamp

    Returns
    -------
    The stamp; one of a missing or unreadable file, or one that is no plain file, has no hash.
    """
    taken = time.time_ns()
    try:
        about = path.stat()
        looks = (about.st_size, about.st_mtime_ns, about.st_ctime_ns, about.st_ino)
        if known is not None and looks == known.looks and known.is_sure:
            return known
        if not stat.S_ISREG(about.st_mode):
            return _NO_FILE
        with path.open("rb") as file:
            return Stamp(*looks, taken, hashlib.file_digest(file, "sha256").hexdigest())
    except (OSError, ValueError):  # a name that no file can have
        return _NO_FILE


_NO_FILE = Stamp(-1, 0, 0, 0, 0, "")


@dataclass(frozen=True, slots=True)
class Content:
    """What a test is made of.

    Parameters
    ----------
    key : of all of it, the `run` of the results that it would have
    inputs : role, file and SHA-256 of each export, and of the lab's dialect cards
    sheet, protocol : SHA-256 of the text of the test sheet and of the resolved protocol; empty
        where they are wrong
    stamps : of the test sheet and the exports, by file
    rests_on : what else the key was made from, to be compared before the stamps are believed
    about : what the test sheet says: test, protocol, type, spool, sample, date, operator
    """

    key: str
    inputs: tuple[tuple[str, str, str], ...] = ()
    sheet: str = ""
    protocol: str = ""
    stamps: Mapping[str, Stamp] = field(default_factory=dict)
    rests_on: tuple[str, ...] = ()
    about: Mapping[str, str] = field(default_factory=dict)

    def as_text(self) -> str:
        """Text that `parse_content` reads back."""
        said = {name: getattr(self, name) for name in ("key", "inputs", "sheet", "protocol")}
        stamps = {name: astuple(stamp) for name, stamp in self.stamps.items()}
        more = {"stamps": stamps, "rests_on": self.rests_on, "about": dict(self.about)}
        return json.dumps(said | more)


def parse_content(text: str) -> Content | None:
    """Read a content from text; None from text that is none, such as an empty one.

    Parameters
    ----------
    text : of `Content.as_text`
    """
    try:
        said = json.loads(text)
        said["inputs"] = tuple(map(tuple, said["inputs"]))
        said["stamps"] = {name: Stamp(*sentence) for name, sentence in said["stamps"].items()}
        said["rests_on"] = tuple(said["rests_on"])
        return Content(**said)
    except (ValueError, TypeError, AttributeError, KeyError):
        return None


@dataclass(frozen=True, slots=True)
class _Resolved:
    """A protocol with what tests of one kind change in it."""

    text: str
    protocol: Protocol


class ContentKeys:
    """Tells what tests are made of; remembers protocols as long as it lives.

    A protocol is read again by the next one: one lives as long as a command.
    """

    def __init__(self) -> None:
        self._found: dict[tuple[str, str], Path | Fault] = {}
        self._hashes: dict[Path, str] = {}
        self._resolved: dict[str, _Resolved] = {}
        self._cards: str | None = None

    def content_of(self, sheet_path: Path, known: Content | None = None) -> Content:
        """Tell what a test is made of.

        Parameters
        ----------
        sheet_path : its test.yaml
        known : what it was made of last time; what is unchanged is not read again

        Returns
        -------
        The content. A test that is not fit to be processed has a key, too: of what can be read.
        """
        folder = sheet_path.parent
        if known is None:
            return self._anew(sheet_path, {})
        stamps = {name: stamp_of(folder / name, old) for name, old in known.stamps.items()}
        is_same = all(stamps[name].sha256 == old.sha256 for name, old in known.stamps.items())
        if is_same and known.rests_on and known.rests_on == self._rests_on(folder, known.rests_on):
            if all(stamps[name] == old for name, old in known.stamps.items()):
                return known
            return replace(known, stamps=stamps)
        return self._anew(sheet_path, stamps)

    def _anew(self, sheet_path: Path, known: Mapping[str, Stamp]) -> Content:
        folder = sheet_path.parent
        stamps = {SHEET_NAME: stamp_of(sheet_path, known.get(SHEET_NAME))}
        try:
            sheet = load_test_sheet(sheet_path)
            text = sheet_path.read_text(encoding="utf-8")
        except (LabpipeError, OSError, ValueError):
            return self._unfit(folder, stamps, "")
        for names in sheet.files.values():
            stamps |= {name: stamp_of(folder / name, known.get(name)) for name in names}
        try:
            resolved = self._resolve(sheet, sheet_path, text)
            cards = cards_in_play(resolved.protocol)
        except LabpipeError:
            return replace(self._unfit(folder, stamps, sheet.protocol), about=_about(sheet))
        exports = named_exports(sheet, resolved.protocol)
        inputs = [(role, name, stamps[name].sha256) for role, name in exports]
        inputs += [(card.role, card.file, card.sha256) for card in cards]
        key = key_of([(role, sha256) for role, _, sha256 in inputs], text, resolved.text)
        rests_on = self._rests_on(folder, (sheet.protocol,))
        made_of = _sha256(text), _sha256(resolved.text)
        return Content(key, tuple(inputs), *made_of, stamps, rests_on, _about(sheet))

    def _unfit(self, folder: Path, stamps: Mapping[str, Stamp], protocol: str) -> Content:
        """The content of a test that cannot be processed as it stands."""
        rests_on = self._rests_on(folder, (protocol,))
        files = [[name, stamp.sha256] for name, stamp in stamps.items()]
        parts = ["unfit", files, *rests_on[1:]]
        return Content(_sha256(json.dumps(parts)), stamps=stamps, rests_on=rests_on)

    def _rests_on(self, folder: Path, wanted: tuple[str, ...]) -> tuple[str, ...]:
        """The protocol that a test wants, its text, the lab's cards and the code, as hashes."""
        name = wanted[0]
        return name, self._protocol_text(name, folder), self._all_cards(), _code()

    def _protocol_text(self, name: str, folder: Path) -> str:
        """Hash of the protocol as written; empty where there is none."""
        found = self._protocol_file(name, folder)
        if isinstance(found, Fault):
            return ""
        if found not in self._hashes:
            self._hashes[found] = stamp_of(found).sha256
        return self._hashes[found]

    def _protocol_file(self, name: str, folder: Path) -> Path | Fault:
        is_path = any(sign in name for sign in "/\\.")
        wanted = (name, str(folder) if is_path else "")
        if wanted not in self._found:
            self._found[wanted] = find_protocol(name, beside=folder)
        return self._found[wanted]

    def _all_cards(self) -> str:
        if self._cards is None:
            from labpipe.readers.load_frame.cards import lab_card_files

            cards = [[file.name, stamp_of(file).sha256] for file in lab_card_files()]
            self._cards = _sha256(json.dumps(cards)) if cards else ""
        return self._cards

    def _resolve(self, sheet: TestSheet, sheet_path: Path, text: str) -> _Resolved:
        """Resolve the protocol of a test; once for all tests that say the same of it."""
        said: Any = parse_yaml(text, str(sheet_path)).data
        kept = {key: value for key, value in said.items() if key not in _NOT_IN_PROTOCOL}
        specimen = kept.get("specimen") or {}
        kept["specimen"] = {key: specimen[key] for key in specimen if key not in _OF_SPECIMEN}
        written = self._protocol_text(sheet.protocol, sheet_path.parent)
        kind = json.dumps([written, sorted(sheet.files), kept], sort_keys=True)
        if kind not in self._resolved:
            protocol = resolve(sheet, sheet_path, follow_links=True)
            self._resolved[kind] = _Resolved(dump_protocol(protocol), protocol)
        return self._resolved[kind]


def _about(sheet: TestSheet) -> dict[str, str]:
    """What a test sheet says of its test."""
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
    """Hash of what makes a resolved protocol from a written one, and of the processing version."""
    package = Path(labpipe.__file__).parent
    files = sorted([*package.glob("protocol/*.py"), *package.glob("records/*.py")])
    digest = hashlib.sha256(str(PROCESSING_VERSION).encode())
    for file in [*files, package / "units.py"]:
        digest.update(file.read_bytes())
    return digest.hexdigest()


def changes(
    *, inputs: Iterable[tuple[str, str, str]], sheet: str, protocol: str, now: Content
) -> str:
    """Say what changed since a test was processed.

    Parameters
    ----------
    inputs : role, file and SHA-256 of what it was made of then
    sheet, protocol : SHA-256 of their texts then; empty where that is not known
    now : what it is made of

    Returns
    -------
    Such as ``export changed (force.mat), sheet changed``.
    """
    then = {file: sha256 for _, file, sha256 in inputs}
    files = sorted(
        {file for _, file, sha256 in now.inputs if then.get(file) != sha256}
        | then.keys() - {file for _, file, _ in now.inputs}
    )
    said = [f"export changed ({', '.join(files)})"] if files and then and now.inputs else []
    if not sheet or not now.sheet:
        return ", ".join(said) or "something changed"
    said += ["sheet changed"] if sheet != now.sheet else []
    said += ["protocol changed"] if protocol != now.protocol else []
    return ", ".join(said) or "newer labpipe"


def _sha256(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()
