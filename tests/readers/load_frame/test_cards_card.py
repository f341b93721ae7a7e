from __future__ import annotations

import pytest

from labpipe.errors import ReadError
from labpipe.readers.load_frame.cards import parse_card

GOOD = """
about = "a card"
recognise = ["^ACME"]
names = "above units"
time = ["time"]
"""


def test_a_card() -> None:
    card = parse_card(
        GOOD + 'separators = ["blanks", ","]\n[units]\nF = "N"', name="acme", source="x"
    )
    assert (card.name, card.separators, card.units["F"]) == ("acme", (" ", ","), "N")
    assert card.time[0].fullmatch("TIME")


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("names =", r"acme\.toml: expected a card in TOML, found text that is none \(Invalid"),
        (GOOD + "seperators = []", r"acme\.toml, key seperators: expected a key of a card, found "),
        ('about = "a"', r"key recognise: expected this key, found none\. Add it to the card"),
        (GOOD + 'separators = ["=="]', r'key separators: expected one sign, or "blanks", found'),
        (GOOD + "separators = ','", r"key separators: expected a list in square brackets, found '"),
        (GOOD + "layout = 'blocs'", r"key layout: expected one of .*'blocks', .* found 'blocs'\. "),
        (GOOD + "version = '(a)(b)'", r"key version: expected a pattern with one group in round b"),
        (GOOD + "start = '('", r"key start: expected a pattern, found '\(' \(missing \)"),
        (GOOD + "blank = 1", r"key blank: expected true or false, found 1"),
        (GOOD + "missing = ['a']", r"key missing: expected a number, found 'a'"),
        (GOOD + f"missing = [{'9' * 400}]", r"key missing: expected a number, found 999"),
        (GOOD + f"missing = [{'9' * 5000}]", r"expected a card in TOML, found text that is none"),
        (GOOD + "a = " + 4000 * "[", r"acme\.toml: expected a card in TOML, found text that is no"),
        (GOOD + "start = 'a{99999999999999}'", r"key start: expected a pattern, found 'a\{9999"),
        (GOOD + "program = ''", r"key program: expected text, found ''"),
        (GOOD + "encodings = ['utf-9']", r"key encodings: expected the name of an encoding, found"),
        (GOOD + "units = 'N'", r"key units: expected a table of names, found 'N'"),
        (GOOD + "[units]\nF = 1", r"key units\.F: expected text, found 1"),
        (GOOD.replace("above units", "alone"), r"key header_words: expected this key, as names = "),
        (GOOD.replace("above units", "listed"), r"key listed: expected this key \(and `start`\), "),
        (GOOD.replace("above units", "with units"), r"key brackets: expected this key, as names ="),
        (GOOD.replace('["^ACME"]', "[]"), r"key recognise: expected a pattern at least, found non"),
    ],
)  # fmt: skip
def test_faults(text: str, said: str) -> None:
    with pytest.raises(ReadError, match=said):
        parse_card(text, name="acme", source="acme.toml")


def test_the_name_of_a_card() -> None:
    with pytest.raises(
        ReadError, match=r"expected a name of small letters, digits and hyphens, fo"
    ):
        parse_card(GOOD, name="Acme Frame", source="Acme Frame.toml")


def test_all_faults_of_a_card_are_told_at_once() -> None:
    with pytest.raises(ReadError) as refused:
        parse_card("about = 1\nseperators = []\nnames = 'x'", name="acme", source="acme.toml")
    assert [line.partition(":")[0] for line in str(refused.value).split("\n")] == [
        f"acme.toml, key {key}" for key in ("about", "seperators", "names", "recognise", "time")
    ]
