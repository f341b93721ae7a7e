"""Exports that are links: refused where they lead out, unless a person lets them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

from labpipe.errors import ProtocolError
from labpipe.protocol.load import load_test_sheet, resolve

SHEET = """\
test: A1
protocol: own
specimen: {type: A, spool: s, sample: 1}
files: {force: force.mat}
"""
PROTOCOL = "version: 1\nname: own\nsources: {force: {reader: dspace-mat, channel: x, unit: N}}\n"
Resolve = Callable[..., str]


@pytest.fixture
def lab(tmp_path: Path) -> Path:
    """A lab whose test has a link into a store."""
    for folder in ("protocols", "test", "store"):
        (tmp_path / folder).mkdir()
    (tmp_path / "store" / "001.mat").write_bytes(b"synthetic")
    (tmp_path / "test" / "force.mat").symlink_to(tmp_path / "store" / "001.mat")
    return tmp_path


@pytest.fixture
def refusal(lab: Path) -> Resolve:
    """Why a test is refused; empty if it is not."""

    def refusal(*, follow_links: bool = False, protocol: str = "", sheet: str = "") -> str:
        (lab / "protocols" / "own.yaml").write_text(PROTOCOL + protocol, encoding="utf-8")
        path = lab / "test" / "test.yaml"
        path.write_text(SHEET + sheet, encoding="utf-8")
        try:
            resolve(load_test_sheet(path), path, lab / "protocols", follow_links=follow_links)
        except ProtocolError as error:
            return str(error)
        return ""

    return refusal


def test_a_link_out_of_the_folder_is_refused(lab: Path, refusal: Resolve) -> None:
    assert refusal() == (
        f"{lab / 'test' / 'test.yaml'}, line 4, column 16 (files.force): expected a file inside the"
        " folder of the test, found 'force.mat', a link out of it. Copy the export into the folder"
        " of the test and name it from there. Or let links be followed: with --follow-links on the"
        " command line, or 'follow_links: true' in the protocol."
    )


def test_a_link_is_followed_where_the_command_says_so(refusal: Resolve) -> None:
    assert refusal(follow_links=True) == ""


@pytest.mark.parametrize("word", ["true", "True"])
def test_a_link_is_followed_where_the_protocol_says_so(refusal: Resolve, word: str) -> None:
    assert refusal(protocol=f"follow_links: {word}\n") == ""
    assert "a link out of it" in refusal(protocol="follow_links: false\n")


def test_a_test_cannot_say_so_itself(refusal: Resolve) -> None:
    change = "overrides: {follow_links: {value: true, because: x}}\n"
    message = refusal(sheet=change)
    assert "a link out of it" in message
    assert (
        "line 5, column 13 (overrides.follow_links): expected a key that a test may change, found"
        " 'follow_links'. Write it into the protocol, or give --follow-links."
    ) in message


def test_a_link_within_the_folder(lab: Path, refusal: Resolve) -> None:
    (lab / "test" / "force.mat").rename(lab / "test" / "other.mat")
    (lab / "test" / "first.mat").write_bytes(b"synthetic")
    (lab / "test" / "force.mat").symlink_to(lab / "test" / "first.mat")
    assert refusal() == ""


@pytest.mark.parametrize("follow_links", [True, False])
def test_a_link_that_leads_back_to_itself(lab: Path, refusal: Resolve, follow_links: bool) -> None:
    (lab / "test" / "force.mat").unlink()
    (lab / "test" / "force.mat").symlink_to(lab / "test" / "force.mat")
    assert refusal(follow_links=follow_links).endswith(
        "expected a file, found 'force.mat', a link that leads back to itself. Make the link anew."
    )


@pytest.mark.parametrize("name", ["../store/001.mat", "/etc/hostname"])
def test_a_path_that_leaves_the_folder_is_never_followed(
    refusal: Resolve, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setitem(globals(), "SHEET", SHEET.replace("force.mat", name))
    assert "expected a file inside the folder of the test" in refusal(follow_links=True)
