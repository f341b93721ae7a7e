"""Curves from elsewhere: two columns of a table, or what CalculiX prints of a tip."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from labpipe.errors import ReadError
from labpipe.readers.curve_files import CurveColumn, is_calculix, read_curve
from tests.approved import Approve
from tests.readers.load_frame.exports import workbook

ACROSS, UP = CurveColumn("deflection", "m"), CurveColumn("force", "N")


MM, NEWTON = (
    CurveColumn("deflection", "m", "1", "mm"),
    CurveColumn("force", "N", "2", "N"),
)


DEFLECTION, FORCE = [0.0, 0.01, 0.02, 0.0305], [0.0, 0.02, 0.035, 0.05]


def saved(folder: Path, text: str, encoding: str = "utf-8") -> Path:
    path = folder / "curve.csv"
    path.write_text(text, encoding=encoding)
    return path


def refusal(path: Path, across: CurveColumn = ACROSS, up: CurveColumn = UP) -> str:
    with pytest.raises(ReadError) as caught:
        read_curve(path, across, up)
    return str(caught.value).replace(str(path), path.name)


@pytest.mark.parametrize(
    "text",
    [
        "deflection / m,force / N\n0,0\n0.01,0.02\n0.02,0.035\n0.0305,0.05\n",
        "deflection_mm,force [mN]\n0,0\n10,20\n20,35\n30.5,50\n",
        "Deflection (mm);Force (N)\n0;0\n10;0,02\n20;0,035\n30,5;0,05\n",
        "tip displacement, cm\tforce, N\n0\t0\n1\t0,02\n2\t0,035\n3,05\t0,05\n",
        "deflection / µm;force / N\r\n0;0\r\n10000;0,02\r\n20000;0,035\r\n30500;0,05\r\n",
        "deflection,force\nmm,N\n0,0\n10,0.02\n20,0.035\n30.5,0.05\n",
        "deflection,force\n[mm],[mN]\n0,0\n10,20\n20,35\n30.5,50\n",
        "# deflection_m force_N\n0 0\n1e-2 2e-2\n2e-2 3.5e-2\n3.05e-2 5e-2\n",
        "a remark\n\nstep,deflection_mm,force_N\n1,0,0\n2,10,0.02\n3,20,.035\n\n4,30.5,0.05\n",
        '"deflection / mm","force / N"\n"0","0"\n"10","0,02"\n"20","0,035"\n"30,5","0,05"\n',
    ],
)
def test_headings_say_column_and_unit(tmp_path: Path, text: str) -> None:
    encoding = "latin-1" if "µ" in text else "utf-16" if ";" in text else "utf-8-sig"
    across, up = read_curve(saved(tmp_path, text, encoding), ACROSS, UP)
    np.testing.assert_allclose(across, DEFLECTION, rtol=1e-12)
    np.testing.assert_allclose(up, FORCE, rtol=1e-12)


FIXED = "deflection / mm;force / N\n0.000;0.000\n6.000;10.250\n12.000;20.500"


@pytest.mark.parametrize("cut", range(1, len("12.000;20.500")))
def test_a_file_that_is_cut_off_in_its_last_line_is_refused(tmp_path: Path, cut: int) -> None:
    message = refusal(saved(tmp_path, FIXED[:-cut]))
    assert message.startswith("curve.csv: expected complete rows of finite numbers")
    assert "the last line (4) is incomplete" in message


@pytest.mark.parametrize(
    "text",
    [
        FIXED,
        f"{FIXED}\n",
        "deflection / mm,force / N\n0,0\n6,10.25\n12,20.5",  # last zeros are not written
        "deflection / mm,force / N\n0,0,\n6,10.25,\n12,20.5,",
        "0 0\n6 10.25\n12 20.5",
    ],
)
def test_a_last_line_without_a_line_end(tmp_path: Path, text: str) -> None:
    asked = (ACROSS, UP) if "/" in text else (MM, NEWTON)
    across, up = read_curve(saved(tmp_path, text), *asked)
    np.testing.assert_allclose(across, [0.0, 0.006, 0.012])
    np.testing.assert_allclose(up, [0.0, 10.25, 20.5])


def test_a_page_of_blanks_is_read_in_no_time(tmp_path: Path) -> None:
    """By backtracking over pairs of blanks it took minutes."""
    blanks = 200_000 * " "
    for line in (f"x{blanks}", f"x{blanks}(", f"x({blanks}", f"x{blanks}; y{blanks}z"):
        across, _ = read_curve(saved(tmp_path, f"{line}\n{FIXED}\n"), ACROSS, UP)
        np.testing.assert_allclose(across, [0.0, 0.006, 0.012])


@pytest.mark.parametrize(
    ("text", "across", "up"),
    [
        (
            "X,U2,RF2\n0,0,-0\n1,-10,-0.02\n2,-20,-0.035\n3,-30.5,-0.05\n",
            CurveColumn("deflection", "m", "u2", "mm", sign=-1),
            CurveColumn("force", "N", "RF2", "N", sign=-1),
        ),
        (
            "A,,B,\nX,Y,X,Y\n0,0,0,0\n1,1,10,.02\n2,2,20,.035\n3,3,30.5,.05\n4,4,,\n",
            CurveColumn("deflection", "m", "3", "mm"),
            CurveColumn("force", "N", "4", "N"),
        ),
    ],
    ids=["names with signs", "side by side"],
)
def test_columns_that_are_named(
    tmp_path: Path, text: str, across: CurveColumn, up: CurveColumn
) -> None:
    curve = read_curve(saved(tmp_path, text), across, up)
    np.testing.assert_allclose(curve, [DEFLECTION, FORCE], rtol=1e-12)


def test_the_first_sheet_of_a_workbook(tmp_path: Path) -> None:
    rows: list[list[object]] = [["deflection / mm", "force / N"], [0, 0], [10, 0.02]]
    rows += [[20, 0.035], [30.5, 0.05]]
    path = workbook(tmp_path / "curve.xlsx", {"Sheet": rows})
    np.testing.assert_allclose(read_curve(path, ACROSS, UP), [DEFLECTION, FORCE], rtol=1e-12)
    rows[3][1] = "=1/0"
    workbook(path, {"Sheet": rows})
    assert "cell B4: expected a value, found a formula without" in refusal(path)


HEAD = "deflection / mm,force / N\n"


def column(name: str | None = None, unit: str = "mm") -> CurveColumn:
    return CurveColumn("deflection", "m", name, unit)


def test_columns_that_are_refused(tmp_path: Path, approved: Approve) -> None:
    """Names and numbers that are not there, one column twice, a unit that contradicts."""
    path = saved(tmp_path, "X,U2,RF2\n0,0,0\n1,1,1\n2,2,2\n")
    messages = [refusal(path, column("U3")), refusal(path, column("4"))]
    messages.append(refusal(path, column("U2"), NEWTON))
    path = saved(tmp_path, "deflection / m,force / N\n0,0\n1,1\n2,2\n")
    approved([*messages, refusal(path, column())])
    across, _ = read_curve(path, column(unit="metre"), UP)
    assert across.tolist() == [0.0, 1.0, 2.0]


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


def saved_dat(folder: Path, text: str) -> Path:
    path = folder / "wire.dat"
    path.write_text(text, encoding="ascii")
    return path


def whole(name: str = "TIPHALF") -> str:
    return "".join(pushed(share, name) for share in SHARES)


@pytest.mark.parametrize(("name", "times"), [("TIPHALF", 2.0), ("TIP", 1.0)])
def test_deflection_and_force_of_the_tip(tmp_path: Path, name: str, times: float) -> None:
    assert is_calculix(whole(name).splitlines())
    assert not is_calculix(["deflection / m,force / N", "0,0"])
    assert not is_calculix([])
    deflection, force = read_curve(saved_dat(tmp_path, whole(name)), ACROSS, UP)
    np.testing.assert_allclose(deflection, 0.05 * np.array(SHARES), rtol=1e-6)
    np.testing.assert_allclose(force, times * 0.04 * np.array(SHARES), rtol=1e-6)


REFUSED = [
    "",
    "deflection / mm,force / N\n",
    "time / s,forse / N\n0,0\n1,1\n2,2\n",
    "deflection / mm,forse / N\n0,0\n1,1\n2,2\n",
    "0,0\n1,1\n2,2\n",
    "deflection,force / N\n0,0\n1,1\n2,2\n",
    "deflection / mm,force_mm\n0,0\n1,1\n2,2\n",
    "deflection / mm,force / mm\n0,0\n1,1\n2,2\n",
    "deflection / mm,deflection / m,force / N\n0,0,0\n1,1,1\n2,2,2\n",
    f"{HEAD}0,0\n1,1\n",
    f"{HEAD}0,0\n1,nan\n2,2\n",
    f"{HEAD}0,0\n1,1e999\n2,2\n",
    f"{HEAD}0,0\n1,\n2,2\n",
    f"{HEAD}0,0\n1,1.234.567\n2,2\n",
    f"{HEAD}0,0\n1,1.2.3\n2,2\n",
    f"{HEAD}0,0\n1\n2,2\n",
    f"{HEAD}0,0\n1,1\nx,y\n2,2\n",
    f"{HEAD}0,0\n2,2\n1,1\n",
    f"{HEAD}0,0\n1,1\n1,2\n",
    f"{HEAD}0,0\n-1,1\n-2,2\n",
    f"{HEAD}0,0\n1,-1\n2,-2\n",
    "deflection / mm;force / N\n0;0\n1,5;0.1\n2;2\n",
]


def test_what_is_refused(tmp_path: Path, approved: Approve) -> None:
    approved(refusal(saved(tmp_path, text)) for text in REFUSED)


def test_calculix_files_that_are_refused(tmp_path: Path, approved: Approve) -> None:
    parts = [pushed(share) for share in (*SHARES, 1.25)]
    moved = [part.partition("\n total")[0] for part in parts]
    u, rf = zip(*(part.split("\n total") for part in parts), strict=True)
    texts = [
        whole() + pushed(1.25, "CLAMP"),
        "".join(moved[:-1]),
        whole() + moved[-1],
        whole().replace("  2.500000E-02", "  *************", 1),
        whole()[:-20],
        whole() + "\n displacements (vx,vy,vz) for set TIPHALF and time  0.13E+01\n",
        pushed(0.25) + pushed(0.5),
        "".join(u) + "".join(f"\n total{part}" for part in reversed(rf)),
    ]
    messages = [refusal(saved_dat(tmp_path, text)) for text in texts]
    turned = CurveColumn("deflection", "m", sign=-1)
    messages += [refusal(saved_dat(tmp_path, whole()), asked) for asked in (turned, column())]
    approved(messages)
