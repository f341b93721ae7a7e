"""What the digest of the study sees, and what it does not."""

from __future__ import annotations

import pytest

from tests.coverage.rests_on import PIPELINE, SIMULATORS, digest, modules, plain

CODE = "def slope(x):\n    return 2 * x\n"


@pytest.mark.parametrize(
    "same",
    [
        '"""A module."""\n\ndef slope(x):\n    """Twice."""\n    return 2 * x  # doubled\n',
        "def slope(\n    x,\n):\n\n    return (2 * x)\n",
    ],
)
def test_words_and_layout_do_not_count(same: str) -> None:
    assert plain(same) == plain(CODE)


def test_numbers_count() -> None:
    assert plain(CODE.replace("2", "3")) != plain(CODE)


def test_words_of_the_schema_do_not_count() -> None:
    field = 'over = Field(0.5, description="{}")'
    assert plain(field.format("a")) == plain(field.format("b"))
    assert plain('f(0.5, title="a")') != plain('f(0.5, title="b")')


def test_modules_on_the_way_to_results() -> None:
    found = modules(*PIPELINE)
    assert {"labpipe.fits.slack", "labpipe.signal.filters", "labpipe.results.cycles"} <= found
    assert {"labpipe.uncertainty", "labpipe.protocol.schema", "labpipe.readers"} <= found
    assert not [name for name in found if name.startswith(("labpipe.report", "labpipe.store"))]


def test_modules_of_the_simulators() -> None:
    foreign, lab = (modules(*starts) for starts in SIMULATORS.values())
    assert {
        "tests.judges.foreign.bends",
        "tests.judges.foreign.noise",
        "tests.judges.foreign.definitions",
    } <= foreign
    assert not [name for name in foreign if name.startswith("labpipe")]
    assert {"labpipe.virtual_lab.recorders", "tests.coverage.lab_bending"} <= lab


def test_protocols_have_digests_of_their_own() -> None:
    assert digest("foreign", "tensile") != digest("foreign", "pet-tape")
    assert digest("foreign", "pet-tape") != digest("lab", "pet-tape")
