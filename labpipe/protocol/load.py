"""Loading of YAML files: protocols, test sheets, plans and harnesses; one error has all faults."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, TypeVar, cast

import yaml

from labpipe.errors import Fault, ProtocolError, sort_by_likeness
from labpipe.protocol.cross_checks import find_implausible_sizes
from labpipe.protocol.grammar import Block
from labpipe.protocol.overrides import (
    allows_links,
    apply_overrides,
    find_absent_needs,
    find_link_faults,
    remove_absent_sources,
)
from labpipe.protocol.schema import Protocol
from labpipe.protocol.sheet_grammar import SHEET_NAME, TestSheet, parse_wires
from labpipe.protocol.source import ROLES
from labpipe.protocol.yaml_text import (
    Document,
    Values,
    build_choice_fault,
    build_error,
    get_block,
    parse_yaml,
    read_text,
)

if TYPE_CHECKING:
    from labpipe.protocol.harness_file import HarnessFile
    from labpipe.protocol.plans import CalibrationPlan, CampaignPlan


_SUFFIXES = (".yaml", ".yml")
_Dumper = yaml.CSafeDumper if yaml.__with_libyaml__ else yaml.SafeDumper


def list_protocol_folders(protocols: Path | None = None) -> tuple[Path, ...]:
    """List the existing folders of protocols in the order of the search.

    Parameters
    ----------
    protocols : the lab's folder; ``protocols`` in the working folder if None

    Returns
    -------
    The lab's folder, then the shipped one.
    """
    lab_folder = Path("protocols") if protocols is None else protocols
    folders = (find_shipped_folder("protocols"), lab_folder)
    unique = {folder.resolve(): folder for folder in folders if folder.is_dir()}
    return tuple(reversed(unique.values()))


def find_shipped_folder(name: str) -> Path:
    """Find a folder of files that are shipped with labpipe.

    Parameters
    ----------
    name : ``protocols`` or ``examples``

    Returns
    -------
    The folder: in the installed package, or beside the package in a checkout.
    """
    package = Path(__file__).resolve().parents[1]
    installed = package / "shipped" / name
    return installed if installed.is_dir() else package.parent / name


def list_protocols(protocols: Path | None = None) -> dict[str, Path]:
    """List the files of all protocols by name; a lab's protocol replaces a shipped one.

    Parameters
    ----------
    protocols : as for `list_protocol_folders`
    """
    files: dict[str, Path] = {}
    for folder in list_protocol_folders(protocols):
        for path in sorted(folder.iterdir()):
            if path.suffix in _SUFFIXES:
                files.setdefault(path.stem, path)
    return files


def find_protocol(wanted: str, *, beside: Path, protocols: Path | None = None) -> Path | Fault:
    """Find the file of a protocol.

    Parameters
    ----------
    wanted : its name, or its path: in the folder of the test sheet, or else in the working folder
    beside : folder of the test sheet
    protocols : as for `list_protocol_folders`

    Returns
    -------
    The file, or the fault of the key ``protocol`` of the sheet.
    """
    if wanted.endswith(_SUFFIXES) or "/" in wanted or "\\" in wanted:
        places = [beside / wanted, Path(wanted)]
        files = [place for place in places if path_exists(place)]
        fault = Fault.of("protocol.no_protocol_at", ("protocol",), name=wanted, places=places)
        return files[0] if files else fault
    protocol_files = list_protocols(protocols)
    if wanted in protocol_files:
        return protocol_files[wanted]
    if protocol_files:
        return build_choice_fault(("protocol",), wanted, protocol_files, "one of the protocols")
    return Fault.of("protocol.no_protocols", ("protocol",), name=wanted)


def path_exists(path: Path) -> bool:
    """Return whether a file or folder exists; False for names that the system refuses."""
    try:
        return path.exists()
    except OSError:  # a name that is too long
        return False


_B = TypeVar("_B", bound=Block)


def load_protocol(path: Path) -> Protocol:
    """Load a protocol.

    Parameters
    ----------
    path : the YAML file

    Returns
    -------
    The protocol with defaults.

    Raises
    ------
    ProtocolError
        If the file cannot be read or is invalid; the message has one line per fault.
    """
    return parse_protocol(read_text(path), str(path))


def parse_protocol(text: str, name: str) -> Protocol:
    """Parse a protocol from text, such as that in a result file.

    Parameters
    ----------
    text : YAML
    name : of the file, for messages

    Returns
    -------
    The protocol with defaults.

    Raises
    ------
    ProtocolError
        If it is invalid; the message has one line per fault.
    """
    return _parse_valid_protocol(text) or validate_document(Protocol, parse_yaml(text, name))


@lru_cache(maxsize=64)
def _parse_valid_protocol(text: str) -> Protocol | None:
    """Parse a protocol, cached for all its tests and results; None if it is invalid."""
    try:
        return validate_document(Protocol, parse_yaml(text, ""))
    except ProtocolError:
        return None


def load_test_sheet(path: Path) -> TestSheet:
    """Load a test sheet. `resolve` checks whether its exports are links out of its folder.

    Parameters
    ----------
    path : the ``test.yaml``

    Returns
    -------
    The test sheet.

    Raises
    ------
    ProtocolError
        If it is invalid; the message has one line per fault.
    """
    return validate_document(TestSheet, parse_yaml(read_text(path), str(path)))


def load_calibration_plan(path: Path) -> CalibrationPlan:
    """Load the plan of a calibration.

    Parameters
    ----------
    path : the YAML file

    Returns
    -------
    The plan with defaults.

    Raises
    ------
    ProtocolError
        If it is invalid; the message has one line per fault.
    """
    from labpipe.protocol.plans import CalibrationPlan  # imported on use: most commands need none

    return validate_document(CalibrationPlan, parse_yaml(read_text(path), str(path)))


def load_campaign_plan(path: Path) -> CampaignPlan:
    """Load the plan of a campaign.

    Parameters
    ----------
    path : the YAML file

    Returns
    -------
    The plan with defaults.

    Raises
    ------
    ProtocolError
        If it is invalid; the message has one line per fault.
    """
    from labpipe.protocol.plans import CampaignPlan  # imported on use: most commands need none

    return validate_document(CampaignPlan, parse_yaml(read_text(path), str(path)))


def load_harness(path: Path) -> HarnessFile:
    """Load a harness.

    Parameters
    ----------
    path : the YAML file

    Returns
    -------
    The harness with defaults; its line is long enough for its boundaries.

    Raises
    ------
    ProtocolError
        If it is invalid, or a file that it names does not exist; the message has one line per
        fault.
    """
    from labpipe.protocol.harness_file import (
        HarnessFile,
        find_missing_files,
        find_unreachable_places,
    )

    document = parse_yaml(read_text(path), str(path))
    harness = validate_document(HarnessFile, document)
    faults = [*find_missing_files(harness, path), *find_unreachable_places(harness)]
    if faults:
        raise build_error(list(map(document.place, faults)))
    return harness


def resolve(
    sheet: TestSheet,
    sheet_path: Path,
    protocols: Path | None = None,
    *,
    follow_links: bool = False,
) -> Protocol:
    """Find the protocol of a test and apply the test sheet to it.

    Parameters
    ----------
    sheet : the test sheet
    sheet_path : its file
    protocols : folder of the lab's protocols; ``protocols`` in the working folder if None
    follow_links : whether exports may be links out of the folder of the test, even if the protocol
        does not allow them

    Returns
    -------
    The protocol with defaults, the overrides and the dimensions of the specimen, and without steps
    and results that need an absent optional export.

    Raises
    ------
    ProtocolError
        If the protocol does not exist or is invalid, an override does not fit it, the roles of the
        files are not those of its sources, or an export is a link that is not allowed; the message
        has one line per fault.
    """
    sheet_document = parse_yaml(read_text(sheet_path), str(sheet_path))
    protocol_file = find_protocol(sheet.protocol, beside=sheet_path.parent, protocols=protocols)
    if isinstance(protocol_file, Fault):
        raise build_error([sheet_document.place(protocol_file)])
    text, name = read_text(protocol_file), str(protocol_file)
    plain, merged = parse_yaml(text, name), parse_yaml(text, name)
    apply_overrides(merged, sheet_document)
    followed = follow_links or allows_links(plain)
    sheet_faults = [
        *_find_role_faults(sheet, merged.block),
        *find_link_faults(sheet, sheet_path.parent, followed=followed),
        *_find_implausible_sizes(sheet, sheet_document, merged.block),
        *_find_wrong_answers(sheet, get_block(merged.data, "questions")),
    ]
    placed = [*merged.faults, *map(sheet_document.place, sheet_faults)]
    protocol = Protocol.read(merged.data)
    if isinstance(protocol, list):
        is_valid_alone = isinstance(Protocol.read(plain.data), Protocol)
        for fault in protocol:
            by_sheet = is_valid_alone and merged.find_location(fault.path)[0].file != str(
                sheet_path
            )
            remark = f"(With the overrides of {sheet_path}.)" if by_sheet else ""
            placed.append(merged.place(fault, remark))
        raise build_error(placed)
    steps = tuple(
        step.numbered(int(merged.find_location(("steps", number))[0].name))
        for number, step in enumerate(protocol.steps)
    )
    protocol = protocol.model_copy(update={"steps": steps})
    reduced = remove_absent_sources(protocol, sheet.files)
    placed += [sheet_document.place(fault) for fault in find_absent_needs(reduced, protocol)]
    if placed:
        raise build_error(placed)
    return reduced


def find_missing_exports(sheet: TestSheet, sheet_path: Path) -> ProtocolError | None:
    """Find exports that a test sheet names and that do not exist.

    Parameters
    ----------
    sheet : the test sheet
    sheet_path : its file

    Returns
    -------
    The error with a line per export; None if all exist.
    """
    folder = sheet_path.parent
    missing = [
        (role, name)
        for role, names in sheet.files.items()
        for name in names
        if not path_exists(folder / name)
    ]
    if not missing:
        return None
    document = parse_yaml(read_text(sheet_path), str(sheet_path))
    other_files = [path.name for path in folder.iterdir() if path.name != SHEET_NAME]
    placed = []
    for role, name in missing:
        like = ", ".join(map(repr, sort_by_likeness(name, other_files, limit=3))) or "no files"
        fault = Fault.of("protocol.no_such_export", ("files", role), name=name, like=like)
        placed.append(document.place(fault))
    return build_error(placed, code="missing_export")


def dump_protocol(protocol: Protocol) -> str:
    """Format a protocol as YAML with units and defaults.

    Parameters
    ----------
    protocol : the protocol

    Returns
    -------
    Text that `parse_protocol` reads into an equal protocol.
    """
    data = protocol.model_dump(mode="json", by_alias=True)
    return str(yaml.dump(data, Dumper=_Dumper, sort_keys=False, allow_unicode=True, width=1000))


def validate_document(model: type[_B], document: Document) -> _B:
    """Validate a parsed YAML file.

    Parameters
    ----------
    model : expected block
    document : as parsed

    Raises
    ------
    ProtocolError
        If it is invalid; the message has one line per fault.
    """
    block = model.read(document.data)
    faults = block if isinstance(block, list) else []
    if placed := [*document.faults, *map(document.place, faults)]:
        raise build_error(placed)
    return cast("_B", block)


def _find_implausible_sizes(
    sheet: TestSheet, document: Document, protocol: Values
) -> Iterator[Fault]:
    """Find dimensions of the specimen outside the plausible ranges of the protocol."""
    specimen = dict(get_block(document.data, "specimen"))
    if bundle := get_block(specimen, "bundle"):
        specimen["bundle"] = {**bundle, "wires": parse_wires(bundle.get("wires"))}
    return find_implausible_sizes(
        {"specimen": specimen},
        ["specimen"],
        others=sheet.specimen.dimensions,
        ranges=protocol.get("plausible") or {},
    )


def _find_wrong_answers(sheet: TestSheet, questions: Values) -> Iterator[Fault]:
    """Find answers to no question of the protocol, and answers that the protocol does not list."""
    for name, answer in sheet.specimen.observed.items():
        path, answers = ("specimen", "observed", name), questions.get(name)
        if name not in questions:
            remedy = "The protocol asks no questions; use specimen.labels."
            what = "a question of the protocol:"
            fault = build_choice_fault(path, name, questions, what, remedy=remedy)
            yield replace(fault, at="key")
        elif isinstance(answers, list) and answer not in answers:
            known = ", ".join(map(repr, answers))
            yield Fault.of("protocol.no_answer", path, answers=known, found=answer)


def _find_role_faults(sheet: TestSheet, protocol: Values) -> Iterator[Fault]:
    """Find roles without a source in the protocol, and required sources without a file."""
    sources = get_block(protocol, "sources")
    for role in sheet.files:
        if sources and role not in sources:
            fault = build_choice_fault(("files", role), role, sources, "a role of the protocol:")
            yield replace(fault, at="key")
    for missing in sorted(set(sources) & set(ROLES) - set(sheet.files)):
        if str(get_block(sources, missing).get("optional")).lower() != "true":
            yield Fault.of("protocol.no_file_of_role", ("files",), role=missing)
