"""From YAML to a protocol or a test sheet and back; all faults are in one error."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, cast

import yaml

from labpipe.errors import Fault, ProtocolError, sort_by_likeness
from labpipe.protocol.cross_checks import plausible_faults
from labpipe.protocol.grammar import Block
from labpipe.protocol.overrides import (
    absent_faults,
    are_followed,
    link_faults,
    with_overrides,
    without_absent,
)
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import SHEET_NAME, TestSheet, wires_in_words
from labpipe.protocol.source import ROLES
from labpipe.protocol.yaml_text import (
    Document,
    Values,
    block_in,
    error_of_faults,
    not_among,
    one_of,
    parse_yaml,
    read_text,
)

if TYPE_CHECKING:
    from labpipe.protocol.harness_file import HarnessFile
    from labpipe.protocol.plans import CalibrationPlan, CampaignPlan


_SUFFIXES = (".yaml", ".yml")
_Dumper = yaml.CSafeDumper if yaml.__with_libyaml__ else yaml.SafeDumper


def protocol_folders(protocols: Path | None = None) -> tuple[Path, ...]:
    """List the folders that hold protocols, in the order in which they are searched.

    Parameters
    ----------
    protocols : the lab's folder; ``protocols`` in the working folder if None

    Returns
    -------
    The lab's folder, and that of labpipe, as far as they exist.
    """
    lab_folder = Path("protocols") if protocols is None else protocols
    folders = (shipped_folder("protocols"), lab_folder)
    unique = {folder.resolve(): folder for folder in folders if folder.is_dir()}
    return tuple(reversed(unique.values()))


def shipped_folder(name: str) -> Path:
    """Find a folder of files that come with labpipe.

    Parameters
    ----------
    name : ``protocols`` or ``examples``

    Returns
    -------
    The folder: inside the package where that was installed, else beside it in the checkout.
    """
    package = Path(__file__).resolve().parents[1]
    installed = package / "shipped" / name
    return installed if installed.is_dir() else package.parent / name


def known_protocols(protocols: Path | None = None) -> dict[str, Path]:
    """List the protocols that can be named, with their files.

    Parameters
    ----------
    protocols : as for `protocol_folders`
    """
    known_protocols: dict[str, Path] = {}
    for folder in protocol_folders(protocols):
        for path in sorted(folder.iterdir()):
            if path.suffix in _SUFFIXES:
                known_protocols.setdefault(path.stem, path)
    return known_protocols


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
        files = [place for place in places if is_there(place)]
        fault = Fault.of("protocol.no_protocol_at", ("protocol",), name=wanted, places=places)
        return files[0] if files else fault
    protocol_files = known_protocols(protocols)
    if wanted in protocol_files:
        return protocol_files[wanted]
    if protocol_files:
        return not_among(("protocol",), wanted, protocol_files, "one of the protocols")
    return Fault.of("protocol.no_protocols", ("protocol",), name=wanted)


def is_there(path: Path) -> bool:
    """Check whether there is a file or a folder of a name, which the system may refuse."""
    try:
        return path.exists()
    except OSError:  # a name that is too long
        return False


_B = TypeVar("_B", bound=Block)


def load_protocol(path: Path) -> Protocol:
    """Read a protocol.

    Parameters
    ----------
    path : the YAML file

    Returns
    -------
    The protocol, defaults filled in.

    Raises
    ------
    ProtocolError
        If anything is wrong with it; the message has one line per fault.
    """
    return parse_protocol(read_text(path), str(path))


def parse_protocol(text: str, name: str) -> Protocol:
    """Read a protocol from text, such as the one that a result file holds.

    Parameters
    ----------
    text : YAML
    name : where it comes from, as in messages

    Returns
    -------
    The protocol, defaults filled in.

    Raises
    ------
    ProtocolError
        If anything is wrong with it; the message has one line per fault.
    """
    return _sound_protocol(text) or checked(Protocol, parse_yaml(text, name))


@lru_cache(maxsize=64)
def _sound_protocol(text: str) -> Protocol | None:
    """Read a protocol once for all results that hold it; None if anything is wrong with it."""
    try:
        return checked(Protocol, parse_yaml(text, ""))
    except ProtocolError:
        return None


def load_test_sheet(path: Path) -> TestSheet:
    """Read a test sheet; whether its exports are links out of its folder, `resolve` looks.

    Parameters
    ----------
    path : the ``test.yaml``

    Returns
    -------
    The test sheet.

    Raises
    ------
    ProtocolError
        If anything is wrong with it; the message has one line per fault.
    """
    return checked(TestSheet, parse_yaml(read_text(path), str(path)))


def load_calibration_plan(path: Path) -> CalibrationPlan:
    """Read what is asked of a calibration.

    Parameters
    ----------
    path : the YAML file

    Returns
    -------
    The plan, defaults filled in.

    Raises
    ------
    ProtocolError
        If anything is wrong with it; the message has one line per fault.
    """
    from labpipe.protocol.plans import CalibrationPlan  # tests do without it

    return checked(CalibrationPlan, parse_yaml(read_text(path), str(path)))


def load_campaign_plan(path: Path) -> CampaignPlan:
    """Read how exports become the tests of a campaign.

    Parameters
    ----------
    path : the YAML file

    Returns
    -------
    The plan, defaults filled in.

    Raises
    ------
    ProtocolError
        If anything is wrong with it; the message has one line per fault.
    """
    from labpipe.protocol.plans import CampaignPlan  # tests do without it

    return checked(CampaignPlan, parse_yaml(read_text(path), str(path)))


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
    from labpipe.protocol.harness_file import HarnessFile, file_faults, reach_faults

    document = parse_yaml(read_text(path), str(path))
    harness = checked(HarnessFile, document)
    faults = [*file_faults(harness, path), *reach_faults(harness)]
    if faults:
        raise error_of_faults(list(map(document.place, faults)))
    return harness


def resolve(
    sheet: TestSheet,
    sheet_path: Path,
    protocols: Path | None = None,
    *,
    follow_links: bool = False,
) -> Protocol:
    """Find the protocol of a test and put the test's own values into it.

    Parameters
    ----------
    sheet : the test sheet
    sheet_path : the file that it was loaded from
    protocols : folder of the lab's protocols; ``protocols`` in the working folder if None
    follow_links : whether exports may be links out of the folder of the test, whatever the
        protocol says

    Returns
    -------
    The protocol, with defaults, overrides and the specimen's dimensions filled in, and without what
    an optional export would have made that the test lacks.

    Raises
    ------
    ProtocolError
        If there is no such protocol, it is wrong, an override does not fit it, the roles of the
        files are not those of its sources, or an export is a link that may not be followed; the
        message has one line per fault.
    """
    sheet_document = parse_yaml(read_text(sheet_path), str(sheet_path))
    protocol_file = find_protocol(sheet.protocol, beside=sheet_path.parent, protocols=protocols)
    if isinstance(protocol_file, Fault):
        raise error_of_faults([sheet_document.place(protocol_file)])
    text, name = read_text(protocol_file), str(protocol_file)
    plain, merged = parse_yaml(text, name), parse_yaml(text, name)
    with_overrides(merged, sheet_document)
    followed = follow_links or are_followed(plain)
    sheet_faults = [
        *_role_faults(sheet, merged.block),
        *link_faults(sheet, sheet_path.parent, followed=followed),
        *_implausible_sizes(sheet, sheet_document, merged.block),
        *_wrong_answers(sheet, block_in(merged.data, "questions")),
    ]
    placed = [*merged.faults, *map(sheet_document.place, sheet_faults)]
    protocol = Protocol.read(merged.data)
    if isinstance(protocol, list):
        is_sound = isinstance(Protocol.read(plain.data), Protocol)
        for fault in protocol:
            by_sheet = is_sound and merged.spot_at(fault.path)[0].file != str(sheet_path)
            remark = f"(With what {sheet_path} changes.)" if by_sheet else ""
            placed.append(merged.place(fault, remark))
        raise error_of_faults(placed)
    steps = tuple(
        step.numbered(int(merged.spot_at(("steps", number))[0].name))
        for number, step in enumerate(protocol.steps)
    )
    protocol = protocol.model_copy(update={"steps": steps})
    reduced = without_absent(protocol, sheet.files)
    placed += [sheet_document.place(fault) for fault in absent_faults(reduced, protocol)]
    if placed:
        raise error_of_faults(placed)
    return reduced


def missing_exports(sheet: TestSheet, sheet_path: Path) -> ProtocolError | None:
    """Find exports that a test sheet names and that are not there.

    Parameters
    ----------
    sheet : the test sheet
    sheet_path : the file that it was loaded from

    Returns
    -------
    The error, with a line per export; None if all are there.
    """
    folder = sheet_path.parent
    missing = [
        (role, name)
        for role, names in sheet.files.items()
        for name in names
        if not is_there(folder / name)
    ]
    if not missing:
        return None
    document = parse_yaml(read_text(sheet_path), str(sheet_path))
    others = [path.name for path in folder.iterdir() if path.name != SHEET_NAME]
    placed = []
    for role, name in missing:
        like = ", ".join(map(repr, sort_by_likeness(name, others, limit=3))) or "no files"
        fault = Fault.of("protocol.no_such_export", ("files", role), name=name, like=like)
        placed.append(document.place(fault))
    return error_of_faults(placed, code="missing_export")


def dump_protocol(protocol: Protocol) -> str:
    """Write a protocol as YAML with units, defaults filled in.

    Parameters
    ----------
    protocol : the protocol

    Returns
    -------
    Text that `parse_protocol` reads into an equal protocol.
    """
    data = protocol.model_dump(mode="json", by_alias=True)
    return str(yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=1000))


def checked(model: type[_B], document: Document) -> _B:
    """Validate a document.

    Parameters
    ----------
    model : the block that it should be
    document : as parsed

    Raises
    ------
    ProtocolError
        If anything is wrong with it; the message has one line per fault.
    """
    block = model.read(document.data)
    faults = block if isinstance(block, list) else []
    if placed := [*document.faults, *map(document.place, faults)]:
        raise error_of_faults(placed)
    return cast("_B", block)


def _implausible_sizes(sheet: TestSheet, document: Document, protocol: Values) -> Iterator[Fault]:
    """Find sizes of the specimen that are outside the ranges of protocol and overrides."""
    specimen = dict(block_in(document.data, "specimen"))
    if bundle := block_in(specimen, "bundle"):
        specimen["bundle"] = {**bundle, "wires": wires_in_words(bundle.get("wires"))}
    return plausible_faults(
        {"specimen": specimen},
        ["specimen"],
        others=sheet.specimen.dimensions,
        ranges=protocol.get("plausible") or {},
    )


def _wrong_answers(sheet: TestSheet, questions: Values) -> Iterator[Fault]:
    """Find observations that the protocol does not ask for, and answers that it does not know."""
    for name, answer in sheet.specimen.observed.items():
        path, answers = ("specimen", "observed", name), questions.get(name)
        if name not in questions:
            no_questions = "The protocol asks no questions; use specimen.labels."
            yield replace(
                not_among(
                    path, name, questions, "a question of the protocol:", remedy=no_questions
                ),
                at="key",
            )
        elif isinstance(answers, list) and answer not in answers:
            yield Fault.of("protocol.no_answer", path, answers=one_of("", answers), found=answer)


def _role_faults(sheet: TestSheet, protocol: Values) -> Iterator[Fault]:
    """Find roles that only one of test sheet and protocol has."""
    sources = block_in(protocol, "sources")
    for role in sheet.files:
        if sources and role not in sources:
            fault = not_among(("files", role), role, sources, "a role of the protocol:")
            yield replace(fault, at="key")
    for missing in sorted(set(sources) & set(ROLES) - set(sheet.files)):
        if str(block_in(sources, missing).get("optional")).lower() != "true":
            yield Fault.of("protocol.no_file_of_role", ("files",), role=missing)
