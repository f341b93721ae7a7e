from __future__ import annotations

import re

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from labpipe.decks.deck_law import abaqus_label, ansys_name, file_stem, on_one_line

names = st.text(min_size=1, max_size=200)
HARD = ['say "A2"', "0.35", "a/b\\c", "..", "Käbel 0,35 mm²", "x" * 300, "two\nlines", "*M1", "--"]


@pytest.mark.slow
@given(names)
@example('say "A2"')
@example("*M1, ELSET=x")
def test_abaqus_labels_are_letters_digits_and_two_signs(name: str) -> None:
    assert re.fullmatch(r"[A-Za-z][A-Za-z0-9_-]{0,79}", abaqus_label(name))


@given(names)
@example("0.35")
@example("²³")
def test_ansys_names_are_eight_letters_and_digits(name: str) -> None:
    assert re.fullmatch(r"[A-Za-z][A-Za-z0-9]{0,7}", ansys_name(name))


@given(names)
@example("../../etc")
@example("aux")
@example("A2.")
def test_file_names_stay_in_their_folder(name: str) -> None:
    stem = file_stem(name)
    assert re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._ +-]{0,99}", stem)
    assert not stem.endswith((".", " "))
    assert stem.lower() not in {"con", "prn", "aux", "nul", "com1", "lpt9"}


@given(names)
@example("two\nlines\rand\x00 more")
def test_a_comment_stays_on_its_line(name: str) -> None:
    assert re.fullmatch(r"[ -~]{0,32}", on_one_line(name, 32))


@pytest.mark.parametrize("name", ["A2", "FLRY-B", "wire_7"])
def test_good_names_are_kept(name: str) -> None:
    assert {abaqus_label(name), file_stem(name)} == {name}


def test_different_names_keep_different_labels() -> None:
    for make in (abaqus_label, file_stem):
        assert len({make(name) for name in [*HARD, "A 1", "A_1", "A/1", "A+1"]}) == len(HARD) + 4


def test_a_label_that_is_cut_ends_in_a_sum() -> None:
    label = abaqus_label("x" * 81)
    assert len(label) == 80
    assert re.fullmatch(r"x{71}_[0-9a-f]{8}", label)


def test_accents_are_left_out() -> None:
    assert on_one_line("Käbel 0,35 mm²", 32) == "Kabel 0,35 mm2"
    assert on_one_line("a name of more than thirty-two letters", 32).endswith("...")
