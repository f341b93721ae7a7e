"""What CalculiX prints of a tip; all files here are synthetic, in the layout of version 2.20."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.readers.curve_files import CurveColumn, is_calculix, read_curve

ACROSS, UP = CurveColumn("deflection", "m"), CurveColumn("force", "N")
SHARES = (0.25, 0.5, 0.75, 1.0)


def pushed(share: float, name: str = "TIPHALF") -> str:
    """The two blocks of one increment."""
    time = f"{share:.7E}"
    tip = 0.05 * share
    return (
        f"\n displacements (vx,vy,vz) for set {name} and time  {time}\n\n"
        f"       392 -2.865725E-06  {tip:.6E}  0.000000E+00\n"
        f"       393 -2.865729E-06  {tip:.6E}  8.783205-104\n"
        f"\n total force (fx,fy,fz) for set {name} and time  {time}\n\n"
        f"        2.285786E-09  {0.04 * share:.6E} -4.107773E-06\n"
    )


def saved(folder: Path, text: str) -> Path:
    path = folder / "wire.dat"
    path.write_text(text, encoding="ascii")
    return path


def whole(name: str = "TIPHALF") -> str:
    return "".join(pushed(share, name) for share in SHARES)


def refusal(folder: Path, text: str, across: CurveColumn = ACROSS) -> str:
    path = saved(folder, text)
    with pytest.raises(ReadError) as caught:
        read_curve(path, across, UP)
    return str(caught.value).replace(str(path), "wire.dat")


@pytest.mark.parametrize(("name", "times"), [("TIPHALF", 2.0), ("TIP", 1.0)])
def test_deflection_and_force_of_the_tip(tmp_path: Path, name: str, times: float) -> None:
    deflection, force = read_curve(saved(tmp_path, whole(name)), ACROSS, UP)
    np.testing.assert_allclose(deflection, 0.05 * np.array(SHARES), rtol=1e-6)
    np.testing.assert_allclose(force, times * 0.04 * np.array(SHARES), rtol=1e-6)


def test_other_files_are_not_taken_for_it() -> None:
    assert is_calculix(whole().splitlines())
    assert not is_calculix(["deflection / m,force / N", "0,0"])
    assert not is_calculix([])


def test_signs_and_units_are_as_of_any_curve(tmp_path: Path) -> None:
    turned = CurveColumn("deflection", "m", sign=-1)
    text = refusal(tmp_path, whole(), turned)
    assert text.startswith("wire.dat, line 13: expected a deflection above the one before")
    in_inches = CurveColumn("deflection", "m", unit="in")
    assert "expected 'in', as in the plan, found 'm'" in refusal(tmp_path, whole(), in_inches)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (
            whole() + pushed(1.25, "CLAMP"),
            "wire.dat: expected one set of nodes, found CLAMP, TIPHALF. "
            "Print U, and RF with TOTALS=ONLY, of one set of nodes, as the deck of labpipe does.",
        ),
        (
            "".join(pushed(share).partition("\n total")[0] for share in SHARES),
            "wire.dat: expected blocks 'total force', found only displacements. "
            "Print U, and RF with TOTALS=ONLY, of one set of nodes, as the deck of labpipe does.",
        ),
        (
            whole() + pushed(1.25).partition("\n total")[0],
            "wire.dat, line 40: expected displacements and total force at time 1.2500000E+00, "
            "found only displacements. Run ccx again; the file may have been cut off.",
        ),
        (
            whole().replace("  2.500000E-02", "  *************", 1),
            "wire.dat, line 13: expected 4 numbers, found '392 -2.865725E-06  *************  "
            "0.000000E+00'. Run ccx again; the file may have been cut off.",
        ),
        (
            whole()[:-20],
            "wire.dat, line 36: expected 3 numbers, found '2.285786E-09  4.00000'. "
            "Run ccx again; the file may have been cut off.",
        ),
        (
            whole() + "\n displacements (vx,vy,vz) for set TIPHALF and time  0.13E+01\n",
            "wire.dat, line 38: expected numbers under 'displacements', found none. "
            "Run ccx again; the file may have been cut off.",
        ),
        (
            pushed(0.25) + pushed(0.5),
            "wire.dat: expected 3 points at least, found 2. Give more points of the curve.",
        ),
    ],
)
def test_what_is_wrong_is_told(tmp_path: Path, text: str, message: str) -> None:
    assert refusal(tmp_path, text) == message


def test_increments_in_another_order(tmp_path: Path) -> None:
    u, rf = zip(*(pushed(share).split("\n total") for share in SHARES), strict=True)
    swapped = "".join(u) + "".join(f"\n total{part}" for part in reversed(rf))
    assert "expected displacements and total force in turn, found" in refusal(tmp_path, swapped)
