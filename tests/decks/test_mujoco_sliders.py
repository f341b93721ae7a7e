"""The MuJoCo decks with memory, run in MuJoCo, against the cantilever of the wire model."""

from __future__ import annotations

import json
import re
import runpy
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from itertools import product
from pathlib import Path

import numpy as np
import pytest

from labpipe.mechanics.decks import DECKS
from labpipe.mechanics.decks.lookup import format_sliders_csv, format_sliders_json
from labpipe.mechanics.decks.mujoco_sliders import format_plane_deck, format_space_deck
from labpipe.mechanics.law.thinning import make_concave_law
from labpipe.mechanics.studies.wire_sheets import read_wire_sheet
from labpipe.mechanics.wire.first_loading import compute_end_load_path
from labpipe.mechanics.wire.wire_table import tabulate_wire
from labpipe.records.arrays import Floats
from labpipe.records.wire import WireTable
from tests.approved import Approve
from tests.judges.rod_references import tips

LENGTH = 0.085
DEFLECTIONS = np.array([3e-3, 5e-3, 10e-3, 20e-3, 30e-3, 40e-3, 50e-3])
EXAMPLES = Path(__file__).resolve().parents[2] / "examples" / "wires.xlsx"
NAMES = ("A1", "A2", "A3", "B1", "B2", "C1", "C2", "C3", "C4", "C5")


TOWARDS = np.radians([0.0, 11.25, 31.5])
"""Along a row of sliders, and where the tip goes sideways most."""


@cache
def example(name: str) -> WireTable:
    return tabulate_wire(read_wire_sheet(EXAMPLES).find_wire(name, ""))


@cache
def bent(name: str) -> tuple[Floats, float]:
    """Loads at the deflections, and what is left of the last when the load is gone."""
    table = example(name)
    law = make_concave_law(table.curvature[1:], table.moment[1:])
    falling = np.linspace(0.0499, 0.0005, 200)
    load = compute_end_load_path(law, LENGTH, np.concatenate([DEFLECTIONS, falling])).load[
        len(DEFLECTIONS) :
    ]
    row = int(np.argmax(load <= 0.0))
    residual = float(np.interp(0.0, load[row : row - 2 : -1], falling[row : row - 2 : -1]))
    return compute_end_load_path(law, LENGTH, DEFLECTIONS).load, residual


@pytest.mark.slow
@pytest.mark.parametrize(
    ("towards", "close"), [(None, 0.015), *((turn, 0.025) for turn in TOWARDS)]
)
@pytest.mark.parametrize("name", NAMES)
def test_every_example_wire_bends_and_keeps_what_it_does(
    name: str, towards: float | None, close: float
) -> None:
    """From 3 to 50 mm of 85 mm, and what is left within 2 %: in a plane, and in space.

    In space less than 0.2 mm out of the plane of the load.
    """
    loads, residual = bent(name)
    write = format_plane_deck if towards is None else format_space_deck
    turn = towards or 0.0
    places = tips(write(example(name), length=LENGTH), np.append(loads, 0.0), turn)
    along = places @ [0.0, np.cos(turn), np.sin(turn)]
    assert along[:-1] == pytest.approx(DEFLECTIONS, rel=close)
    assert along[-1] == pytest.approx(residual, rel=0.02)
    assert np.max(np.abs(places @ [0.0, -np.sin(turn), np.cos(turn)])) < 0.2e-3


@pytest.mark.parametrize(
    ("name", "write"),
    [
        ("C4", format_plane_deck),
        *(
            pytest.param(name, write, marks=pytest.mark.slow)
            for name, write in product(NAMES, (format_plane_deck, format_space_deck))
            if (name, write) != ("C4", format_plane_deck)
        ),
    ],
)
def test_two_cycles(name: str, write: Callable[..., str]) -> None:
    """The second cycle goes the way of the law's loops: the tip comes back to where it was."""
    towards = TOWARDS[1] if write is format_space_deck else 0.0
    along = np.array([0.0, np.cos(towards), np.sin(towards)])
    loads, residual = bent(name)
    half = 0.5 * loads[-1]
    path = np.array([loads[-1], half, 0.0, half, loads[-1], half, 0.0])
    places = tips(write(example(name), length=LENGTH), path, towards)
    deflection = places @ along
    table = example(name)
    law = make_concave_law(table.curvature[1:], table.moment[1:])
    turn = deflection[4]
    legs = [np.linspace(1e-4, turn, 40), np.linspace(turn, residual, 80)[1:]]
    legs += [np.linspace(residual, turn, 80)[1:], np.linspace(turn, residual, 80)[1:]]
    model = compute_end_load_path(law, LENGTH, np.concatenate(legs))
    down, up, second = (model.load[-237:][79 * n : 79 * (n + 1)] for n in range(3))
    assert deflection[4] == pytest.approx(deflection[0], rel=0.005)
    assert deflection[6] == pytest.approx(deflection[2], rel=0.005)
    for place, load, leg in ((1, down, legs[1]), (3, up, legs[2]), (5, second, legs[3])):
        rising = np.argsort(load)
        assert deflection[place] == pytest.approx(
            np.interp(half, load[rising], leg[rising]), rel=0.015
        )
    assert deflection[3] < deflection[1] - 0.2 * residual  # a loop, and no line
    assert np.max(np.abs(places @ [0.0, -np.sin(towards), np.cos(towards)])) < 0.2e-3


@pytest.mark.parametrize(
    ("share", "residual", "ratio"), [(0.35, 8.46, 1.023), (0.65, 11.50, 1.040), (1.0, 15.18, 1.053)]
)
def test_the_example_lets_limits_grow(share: float, residual: float, ratio: float) -> None:
    """A2: what remains of 50 mm, and the second peak."""
    pytest.importorskip("mujoco", reason="needs mujoco-core, of the development extras")
    script = runpy.run_path(str(EXAMPLES.with_name("mujoco_growing.py")))
    deck = format_plane_deck(example("A2"), length=LENGTH, isotropic_share=share)
    first = 0.1312
    tip = 1e3 * script["bend"](deck, [first, 0.0, ratio * first, 0.0])[:, 1]
    assert tip[0] == pytest.approx(50.0, rel=0.002)
    assert tip[1] == pytest.approx(residual, rel=0.012)
    assert tip[2] == pytest.approx(50.0, rel=0.005)
    assert tip[3] > tip[1]


def read_check(deck: str) -> list[float]:
    """Load, deflection, and that without yielding, of the check at the head of a deck."""
    match = re.search(r"Check: pull_y = (\S+) N.* y = (\S+) m, within .* stops at (\S+) m", deck)
    assert match is not None
    return [float(number) for number in match.groups()]


@pytest.mark.parametrize(
    "write",
    [format_plane_deck, pytest.param(format_space_deck, marks=pytest.mark.slow)],
)
def test_the_check_of_a_deck(write: Callable[[WireTable], str]) -> None:
    """By it one sees that an engine lets springs yield; one that does not stays far behind."""
    deck = write(example("C4"))
    load, deflection, stuck = read_check(deck)
    assert tips(deck, np.array([load]))[0, 1] == pytest.approx(deflection, rel=0.02)
    elastic = re.sub(r' springyield="[^"]*"', "", deck)
    assert tips(elastic, np.array([load]))[0, 1] == pytest.approx(stuck, rel=0.02)
    assert stuck < 0.1 * deflection


def test_the_check_of_a_law_that_ends_early() -> None:
    """It is made where the law still goes; a law that ends sooner has none."""
    table = example("A2")
    for last, share in ((60, None), (170, 0.5)):
        short = table.curvature <= table.curvature[last]
        arrays = {
            name: value[short]
            for name in WireTable.__annotations__
            if isinstance(value := getattr(table, name), np.ndarray)
            and value.shape == table.curvature.shape
        }
        deck = format_plane_deck(replace(table, **arrays))
        if share is None:
            assert "Check:" not in deck
        else:
            assert 1e-4 < read_check(deck)[1] < 0.3 * LENGTH


def test_numbers_out_of_range(approved: Approve) -> None:
    table = example("A2")
    calls: list[Callable[[], object]] = [
        lambda: format_plane_deck(table, length=0.0),
        lambda: format_plane_deck(table, isotropic_share=1.2),
    ]
    for mass in (0.0, -1.0, np.nan):
        light = replace(table, mass_per_length=mass)
        endings = ("mujoco.xml", "mujoco-plane.xml", "mujoco-space.xml", "abaqus.inp", "ansys.inp")
        calls += [partial(DECKS[ending], light) for ending in endings]
    messages = []
    for call in calls:
        with pytest.raises(ValueError) as refused:  # noqa: PT011
            call()
        messages.append(str(refused.value))
    approved(messages)


def test_a_law_that_sliders_cannot_have() -> None:
    table = example("A2")
    stiff = replace(table, moment=table.moment * (1.0 + (table.curvature / 50.0) ** 2))
    reason = "Sliders cannot be fitted, so that this deck has no model: the law stiffens at "
    for deck in (format_plane_deck(stiff), format_space_deck(stiff)):
        assert reason in deck
        assert "worldbody" not in deck
    assert reason in format_sliders_csv(stiff)
    assert json.loads(format_sliders_json(stiff))["reason"].startswith(reason)


def test_a_deck_has_all_its_sliders() -> None:
    assert format_plane_deck(example("A2")).count("<fixed ") == 30 * 12
    assert format_space_deck(example("A2")).count("<fixed ") == 30 * 4 * 8
