"""What ``labpipe model`` says of its wires."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from labpipe.cli.model import model_table
from labpipe.records.quality import QualityNote, Severity
from labpipe.records.wire import WireTable
from labpipe.studies.wire_models import Modelled
from tests.builders.wire_tables import wire_table


def said(*tables: WireTable, refused: dict[str, str] | None = None) -> list[str]:
    modelled = Modelled(Path("wires.xlsx"), Path("processed/wires"), tables, refused or {}, ())
    return model_table(modelled).splitlines()


def test_a_line_per_wire_below_heading_and_units() -> None:
    lines = said(wire_table("A2"), wire_table("A3"))
    assert lines[0].split() == [
        *("wire", "strands", "layout", "EI", "stick", "EI", "slip"),
        *("first", "slip", "range", "force", "at", "0.3", "L"),
    ]
    assert lines[1].split() == ["N", "mm^2", "N", "mm^2", "1/m", "1/m", "N"]
    assert [line.split()[0] for line in lines[2:4]] == ["A2", "A3"]


def test_numbers_are_those_of_the_table() -> None:
    table = wire_table("A2")
    name, strands, kind, stick, slip, onset, end, force = said(table)[2].split()
    assert (name, strands, kind) == ("A2", "7", "hexagonal")
    assert float(stick) == float(f"{1e6 * table.stick_stiffness:.5g}")
    assert float(slip) == float(f"{1e6 * table.slip_stiffness:.5g}")
    assert float(onset) == float(f"{table.slip_onsets[0]:.3g}")
    assert float(end) == float(f"{table.curvature[-1]:.4g}")
    at = 0.3 * table.spec.length
    assert np.isclose(float(force), np.interp(at, table.tip_deflection, table.tip_force), rtol=1e-3)


def test_a_curve_that_ends_early_has_no_force() -> None:
    table = wire_table("A2")
    short = replace(
        table,
        tip_deflection=table.tip_deflection[:3],
        tip_force=table.tip_force[:3],
    )
    assert said(short)[2].split()[-1] == "-"


def test_slip_at_once_is_told_from_slip_beyond_the_range() -> None:
    table = wire_table("A2")
    lines = said(
        replace(table, slip_onsets=np.zeros(1)), replace(table, slip_onsets=np.array([np.inf]))
    )
    assert lines[2].split()[5:7] == ["at", "once"]
    assert lines[3].split()[5] == "beyond"


def test_equal_notes_are_told_once_and_warnings_first() -> None:
    taken = QualityNote("defaults_taken", Severity.INFO, "sheet", "poisson 0.34 taken")
    cut = QualityNote("cantilever_cut", Severity.WARNING, "cantilever", "the curve stops at 30 mm")
    one = replace(wire_table("A2"), notes=(taken,))
    other = replace(wire_table("A3"), notes=(taken, cut))
    lines = said(one, other)
    assert lines[5:7] == [
        "  warning: the curve stops at 30 mm  [A3]",
        "  info: poisson 0.34 taken  [A2, A3]",
    ]


def test_refused_wires_are_named_and_the_folder_comes_last() -> None:
    lines = said(wire_table("A2"), refused={"X1": "too thick"})
    assert lines[-2] == "  not modelled: X1 (reasons below)"
    assert lines[-1] == f"results: {Path('processed/wires')}"


def test_of_many_wires_some_are_named() -> None:
    taken = QualityNote("defaults_taken", Severity.INFO, "sheet", "poisson 0.34 taken")
    cut = QualityNote("cantilever_cut", Severity.WARNING, "cantilever", "it stops")
    tables = [
        replace(
            wire_table("A2"), name=f"W{number}", notes=(taken, cut) if number < 12 else (taken,)
        )
        for number in range(13)
    ]
    lines = said(*tables)
    names = ", ".join(f"W{number}" for number in range(10))
    assert f"  warning: it stops  [{names} and 2 more]" in lines
    assert "  info: poisson 0.34 taken  [all 13 wires]" in lines
