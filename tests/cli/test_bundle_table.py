"""What ``labpipe bundle`` says of a bundle."""

from __future__ import annotations

from pathlib import Path

from labpipe.cli.bundle import bundle_table
from labpipe.studies.bundle_bounds import Conduit, ModelledBundle
from labpipe.wire.bundle_model import bundle_model
from tests.builders.bundles import bundle, example_wires


def said(*conduits: Conduit, bore: float | None = None, **wires: int) -> list[str]:
    made = bundle(*wires.items(), arrangement="asymmetric", conduit_bore=bore)
    model = bundle_model(made, example_wires())
    return bundle_table(ModelledBundle("T1", model, conduits, 3.478e-3, Path("out"))).splitlines()


def test_lines_of_one_kind() -> None:
    lines = said(B1=7)
    assert lines[0] == "T1: 7 B1, asymmetric"
    assert lines[1].startswith("  EI, wires slip, strands slip  ")
    assert lines[1].endswith("  1467.9 N mm^2")
    assert lines[3].split()[-3:] == ["141540", "N", "mm^2"]
    assert "in the stiffest (all are alike)" in lines[5]
    assert lines[6].split()[-2:] == ["3.3", "mm"]
    assert lines[7].split()[-2:] == ["3.478", "mm"]
    assert lines[8].startswith("  info: copper that is stretched yields")
    assert lines[-1] == "results: out"


def test_lines_of_a_mixture_in_a_conduit() -> None:
    offered = (Conduit(3e-3, 1.05, False), Conduit(5e-3, 0.38, True))
    lines = said(*offered, bore=5e-3, B1=4, B2=3)
    assert "in the stiffest (0 deg from x)" in lines[5] or "90 deg from x" in lines[5]
    assert lines[8].split()[-6:] == ["1.05", "the", "wires", "do", "not", "fit"]
    assert lines[9].split()[-2:] == ["0.38", "chosen"]


def test_a_bore_for_the_wanted_fraction_that_is_too_small() -> None:
    assert said(B1=7)[7].endswith("3.478 mm")
    model = bundle_model(bundle(("B1", 2)), example_wires())
    lines = bundle_table(ModelledBundle("T2", model, (), 1.859e-3, Path("out"))).splitlines()
    assert lines[6].endswith("2.2 mm")
    assert lines[7].endswith("1.859 mm  the wires do not fit")
