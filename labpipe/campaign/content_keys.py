"""Keys of the inputs of tests: results are outdated if the key of their test has changed.

The key depends on exports, test sheet, resolved protocol and processing version
(`labpipe.process.run.make_input_key`). A file is read again only if its size, times or inode
changed since its last hash, or if that hash was taken within the time resolution of the file
system.
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
from labpipe.process.run import PROCESSING_VERSION, make_input_key
from labpipe.protocol.load import dump_protocol, find_protocol, load_test_sheet, resolve
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import SHEET_NAME, TestSheet
from labpipe.protocol.yaml_text import parse_yaml

_NOT_IN_PROTOCOL = {"test", "date", "operator", "files"}
"""Keys of a test sheet without influence on the resolved protocol, except the roles of files."""
_SAMPLE_KEYS = {"spool", "sample", "labels"}
"""Keys of a specimen without influence on the resolved protocol."""


class Stamp(NamedTuple):
    """Hash of a file, with the state of the file when the hash was taken.

    Parameters
    ----------
    size : bytes
    modified : time of the last change of the content, ns since 1970
    changed : time of the last change of content or attributes, ns since 1970
    inode : number of the file in its file system
    taken : time of the hash, ns since 1970
    sha256 : hexadecimal; empty for an unreadable file
    """

    size: int
    modified: int
    changed: int
    inode: int
    taken: int
    sha256: str

    @property
    def is_reliable(self) -> bool:
        """Return whether any later change of the file changes its size, times or inode.

        False for a hash taken too soon after the last change, or before it (clock set back).
        """
        # ns: the coarsest time resolution of file systems, that of FAT
        time_resolution = 2_000_000_000
        return max(self.modified, self.changed) + time_resolution < self.taken


def take_stamp(path: Path, last: Stamp | None = None) -> Stamp:
    """Take the stamp of a file, without hashing an unchanged file again.

    Parameters
    ----------
    path : the file
    last : its last stamp; None without one

    Returns
    -------
    The stamp; `_NO_FILE` for a missing or unreadable file, a folder, a pipe or a device.
    """
    taken = time.time_ns()
    try:
        status = path.stat()
        state = (status.st_size, status.st_mtime_ns, status.st_ctime_ns, status.st_ino)
        if last is not None and state == last[:4] and last.is_reliable:
            return last
        if not stat.S_ISREG(status.st_mode):
            return _NO_FILE
        with path.open("rb") as file:
            return Stamp(*state, taken, hashlib.file_digest(file, "sha256").hexdigest())
    except (OSError, ValueError):  # ValueError: an impossible name
        return _NO_FILE


_NO_FILE = Stamp(-1, 0, 0, 0, 0, "")


@dataclass(frozen=True)
class Content:
    """Inputs of a test.

    Parameters
    ----------
    key : of all inputs; the `run` of results made from them
    inputs : role, file and SHA-256 of each export and of each dialect card of the lab
    sheet, protocol : SHA-256 of the texts of test sheet and resolved protocol; empty if faulty
    stamps : of the test sheet and the exports, by file
    dependencies : name of the protocol; hashes of its file, of the lab's cards and of the code
    facts : from the test sheet: test, protocol, type, spool, sample, date, operator
    """

    key: str
    inputs: tuple[tuple[str, str, str], ...] = ()
    sheet: str = ""
    protocol: str = ""
    stamps: Mapping[str, Stamp] = field(default_factory=dict)
    dependencies: tuple[str, ...] = ()
    facts: Mapping[str, str] = field(default_factory=dict)

    def as_text(self) -> str:
        """Return JSON for `parse_content`."""
        return json.dumps(vars(self))


def parse_content(text: str) -> Content | None:
    """Parse the text of `Content.as_text`.

    Parameters
    ----------
    text : any

    Returns
    -------
    The content; None for any other text, such as that of an earlier labpipe.
    """
    try:
        fields = json.loads(text)
        fields["inputs"] = tuple(map(tuple, fields["inputs"]))
        fields["stamps"] = {name: Stamp(*values) for name, values in fields["stamps"].items()}
        fields["dependencies"] = tuple(fields["dependencies"])
        return Content(**fields)
    except (ValueError, TypeError, AttributeError, KeyError):
        return None


class ContentKeys:
    """Determines the inputs of tests; reads each protocol once during a command."""

    def __init__(self) -> None:
        self._protocol_files: dict[tuple[str, str], Path | Fault] = {}
        self._protocol_hashes: dict[Path, str] = {}
        self._resolved: dict[str, tuple[str, Protocol]] = {}
        self._cards_hash: str | None = None

    def determine_content(self, sheet_path: Path, last: Content | None = None) -> Content:
        """Determine the inputs of a test.

        Parameters
        ----------
        sheet_path : its test.yaml
        last : its last content; unchanged files are not read again

        Returns
        -------
        The content. If sheet or protocol are faulty, the key is made from the readable files.
        """
        folder = sheet_path.parent
        if last is None:
            return self._read_content(sheet_path, {})
        stamps = {name: take_stamp(folder / name, old) for name, old in last.stamps.items()}
        is_same = all(stamps[name].sha256 == old.sha256 for name, old in last.stamps.items())
        known = last.dependencies
        if is_same and known and known == self._hash_dependencies(folder, known[0]):
            return last if stamps == last.stamps else replace(last, stamps=stamps)
        return self._read_content(sheet_path, stamps)

    def _read_content(self, sheet_path: Path, stamps_before: Mapping[str, Stamp]) -> Content:
        folder = sheet_path.parent
        before = stamps_before.get
        stamps = {SHEET_NAME: take_stamp(sheet_path, before(SHEET_NAME))}
        try:
            sheet = load_test_sheet(sheet_path)
            text = sheet_path.read_text(encoding="utf-8")
        except (LabpipeError, OSError, ValueError):
            return self._faulty_content(folder, stamps, "")
        for names in sheet.files.values():
            stamps |= {name: take_stamp(folder / name, before(name)) for name in names}
        try:
            resolved, protocol = self._resolve(sheet, sheet_path, text)
            cards = fingerprint_dialect_cards(protocol)
        except LabpipeError:
            return replace(
                self._faulty_content(folder, stamps, sheet.protocol), facts=_sheet_facts(sheet)
            )
        exports = list_named_exports(sheet, protocol)
        inputs = [(role, name, stamps[name].sha256) for role, name in exports]
        inputs += [(card.role, card.file, card.sha256) for card in cards]
        key = make_input_key([(role, sha256) for role, _, sha256 in inputs], text, resolved)
        return Content(
            key,
            tuple(inputs),
            sheet=_sha256(text),
            protocol=_sha256(resolved),
            stamps=stamps,
            dependencies=self._hash_dependencies(folder, sheet.protocol),
            facts=_sheet_facts(sheet),
        )

    def _faulty_content(self, folder: Path, stamps: Mapping[str, Stamp], protocol: str) -> Content:
        """Return the content of a test whose sheet or protocol is faulty."""
        dependencies = self._hash_dependencies(folder, protocol)
        files = [[name, stamp.sha256] for name, stamp in stamps.items()]
        parts = ["unfit", files, *dependencies[1:]]
        return Content(_sha256(json.dumps(parts)), stamps=stamps, dependencies=dependencies)

    def _hash_dependencies(self, folder: Path, protocol: str) -> tuple[str, ...]:
        """Return the name of a protocol, and hashes of its file, the lab's cards and the code."""
        return protocol, self._hash_protocol(protocol, folder), self._hash_cards(), _hash_code()

    def _hash_protocol(self, name: str, folder: Path) -> str:
        """Return the hash of the file of a protocol; empty if there is none."""
        is_path = any(character in name for character in "/\\.")
        wanted = (name, str(folder) if is_path else "")
        if wanted not in self._protocol_files:
            self._protocol_files[wanted] = find_protocol(name, beside=folder)
        file = self._protocol_files[wanted]
        if isinstance(file, Fault):
            return ""
        if file not in self._protocol_hashes:
            self._protocol_hashes[file] = take_stamp(file).sha256
        return self._protocol_hashes[file]

    def _hash_cards(self) -> str:
        """Return the hash of the dialect cards of the lab; empty without any."""
        if self._cards_hash is None:
            from labpipe.readers.load_frame.cards import lab_card_files

            cards = [[file.name, take_stamp(file).sha256] for file in lab_card_files()]
            self._cards_hash = _sha256(json.dumps(cards)) if cards else ""
        return self._cards_hash

    def _resolve(self, sheet: TestSheet, sheet_path: Path, text: str) -> tuple[str, Protocol]:
        """Resolve the protocol of a test, once for all tests with the same overrides and sizes."""
        sheet_data: Any = parse_yaml(text, str(sheet_path)).data
        keys = {key: sheet_data[key] for key in sheet_data.keys() - _NOT_IN_PROTOCOL}
        specimen = keys.get("specimen") or {}
        keys["specimen"] = {key: specimen[key] for key in specimen.keys() - _SAMPLE_KEYS}
        protocol_hash = self._hash_protocol(sheet.protocol, sheet_path.parent)
        cache_key = json.dumps([protocol_hash, sorted(sheet.files), keys], sort_keys=True)
        if cache_key not in self._resolved:
            protocol = resolve(sheet, sheet_path, follow_links=True)
            self._resolved[cache_key] = dump_protocol(protocol), protocol
        return self._resolved[cache_key]


def _sheet_facts(sheet: TestSheet) -> dict[str, str]:
    """Return the facts of a test sheet that the catalog lists."""
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
def _hash_code() -> str:
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
    inputs : role, file and SHA-256 of its earlier inputs; empty if not known
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
