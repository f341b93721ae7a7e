"""Tables of numbers, notes and progress on a terminal."""

from __future__ import annotations

import math
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from labpipe.campaign.reporting import WrittenReport
from labpipe.cli import EXIT_ERROR, EXIT_OK
from labpipe.cli.bundle import format_bundle
from labpipe.cli.calibrate import format_calibration
from labpipe.cli.model import format_wire_models
from labpipe.cli.process import format_test
from labpipe.cli.report import format_report
from labpipe.cli.terminal import show_completion
from labpipe.mechanics.studies.bundle_bounds import Conduit, ModelledBundle
from labpipe.mechanics.studies.calibration_file import CalibrationStudy
from labpipe.mechanics.studies.first_loadings import FirstLoading
from labpipe.mechanics.studies.model_comparisons import compare_tests
from labpipe.mechanics.studies.wire_models import ModelledWires
from labpipe.mechanics.wire.bundle_model import compute_bundle_model
from labpipe.mechanics.wire.calibration.calibrate_wire import Settings, calibrate
from labpipe.process.run import ProcessedTest
from labpipe.records.curve import Interval
from labpipe.records.group import Campaign, GroupNumber
from labpipe.records.quality import QualityNote, Reason, Severity
from labpipe.records.result import Contribution, Result, Status
from labpipe.records.wire import Calibration, Identifiability, ParameterChoice, WireTable
from tests.approved import Approve
from tests.builders.bundles import EXAMPLES, bundle, example_wires
from tests.builders.campaigns import build_group, build_number, six_samples, troubled_samples
from tests.builders.external_curves import external_comparison, unmodelled, untested
from tests.builders.loading_tests import measured, wire_of
from tests.builders.small_tests import Run
from tests.builders.wire_tables import wire_table
from tests.store.builders_result import build_result

TESTS = [Path("raw/A/test.yaml"), Path("raw/B/test.yaml")]
EMPTY = replace(
    build_result(half_cycle=0.2, cycles=1),
    test="A2-1",
    protocol="wire",
    display={"displacement": "mm", "energy": "mJ"},
)


def table_of(*results: Result, quality: tuple[QualityNote, ...] = ()) -> list[str]:
    result = replace(EMPTY, results=results, quality=quality)
    lines = format_test(ProcessedTest(Path("out"), result, ())).splitlines()
    return [line.rstrip() for line in lines]


def test_table_of_a_test(approved: Approve) -> None:
    """Display units, marks, reasons once, the largest share, notes that matter, many cycles."""
    budget = (Contribution("noise", 0.3), Contribution("pull offset", -0.4))
    share = Result("share", 53.43, "mm", Interval(53.32, 53.54), budget=budget)
    apart = replace(share, name="apart", estimate=53.1, interval=Interval(53.0, 53.2))
    why, gap = (Reason("x", "y"),), (Reason("gap", "z"),)
    results = [
        Result("peak_displacement.1", 0.05, "m", Interval(0.049, 0.051)),
        Result("clock_drift", 4e-5, "1", Interval(3e-5, 5e-5)),
        Result("peak_force.1", 1.5, "N"),
        *(Result(f"a.{n}", 1.0, "N", status=Status.DOUBTFUL, reasons=why) for n in (1, 2)),
        Result("b", None, "N", status=Status.FAILED, reasons=gap),
        *(share, apart, replace(share, name="bare", budget=())),
    ]
    notes = tuple(QualityNote("c", severity, "force", f"{severity}!") for severity in Severity)
    cycles = [Result(f"peak_force.{n}", float(n), "N") for n in range(1, 63)]
    lost = [replace(results[5], name=f"b.{n}") for n in range(1, 13)]
    approved([*table_of(*results, quality=notes), *table_of(*cycles), *table_of(*lost)])


@pytest.mark.parametrize(
    ("value", "ends", "shown"),
    [
        (1.0927371, (1.0875435, 1.0968408), "1.0927 N 95 %: 1.0875 to 1.0968"),
        (52.264857, (-34.244437, 138.774152), "52 N 95 %: -34 to 139"),
        (1234567.8, (1034567.8, 1434567.8), "1.23e⁶ N 95 %: 1.03e⁶ to 1.43e⁶"),
        (-4e-7, (-6.04e-7, -1.96e-7), "-4.0e⁻⁷ N 95 %: -6.0e⁻⁷ to -2.0e⁻⁷"),
        (8.0, (8.0003, 8.0097), "8.0000 N 95 %: 8.0003 to 8.0097"),
        (0.0, (0.0, 0.0), "0.00000 N 95 %: 0.00000 to 0.00000"),
        (801.25, (757.031, math.inf), "801.25 N 95 %: 757.03 to inf"),
        (53.43, None, "53.430 N"),
    ],
)
def test_digits_follow_the_interval(
    value: float, ends: tuple[float, float] | None, shown: str
) -> None:
    """Two of half its width; a last bit, as processors differ in, changes nothing."""
    for by in (1.0, 1.0 + 2e-16, 1.0 - 1e-9):
        interval = None if ends is None else Interval(by * ends[0], by * ends[1])
        doubts = (Reason("c", "doubted"),)
        line = table_of(Result("a", by * value, "N", interval, Status.DOUBTFUL, doubts))[1]
        assert " ".join(line.replace(" \u00d7 10", "e").split()) == f"? a {shown}"


def test_progress_in_a_pipe(capsys: pytest.CaptureFixture[str]) -> None:
    """A line for each test that ended."""
    with show_completion("test") as (begin_all, say):
        begin_all(2)
        say("B: ok")
        say("A: failed")
    assert capsys.readouterr().err == "1/2 B: ok\n2/2 A: failed\n"


def of_group(*numbers: GroupNumber) -> list[str]:
    """What is said of a report with one group of six samples from two spools."""
    group = replace(build_group("tube", six_samples()), numbers=numbers)
    campaign = Campaign("Synthetic", (group,))
    return format_report(WrittenReport(Path("r"), campaign, (Path("r/report.html"),))).splitlines()


def test_means_in_the_display_unit(approved: Approve) -> None:
    """As they are, apart from their estimate, of some samples, and of none."""
    number = build_number("stiffness_first", six_samples())
    assert number.mean is not None
    low = replace(number.mean.chosen, interval=Interval(4e3, 4.2e3), estimate=4.1e3)
    apart = replace(number, name="apart", mean=replace(number.mean, chosen=low))
    some = build_number("stiffness_second", troubled_samples())
    approved(of_group(number, apart, some, replace(some, name="slack", values={})))


@pytest.mark.parametrize("bore", ["10.7", "0 mm", "2 N"])
def test_invalid_bore_is_refused(run: Run, tmp_path: Path, bore: str) -> None:
    ran = run("bundle", "7 B1", "--wire", EXAMPLES, f"--bore={bore}", "--out", tmp_path / "x")
    assert ran.status == EXIT_ERROR
    message = f'expected a length above zero with its unit, such as "10.7 mm", found {bore!r}'
    assert ran.err.startswith(f"labpipe bundle: --bore: {message}")
    assert not (tmp_path / "x").exists()


def bundle_lines(*conduits: Conduit, bore: float | None = None, **wires: int) -> list[str]:
    harness_bundle = bundle(*wires.items(), arrangement="asymmetric", conduit_bore=bore)
    model = compute_bundle_model(harness_bundle, example_wires())
    return format_bundle(ModelledBundle("T1", model, conduits, 3.478e-3, Path("out"))).splitlines()


@pytest.fixture(scope="module")
def fitted() -> CalibrationStudy:
    curves = measured("A2")
    calibration = calibrate(wire_of("A2"), curves, Settings())
    assert isinstance(calibration, Calibration)
    loadings = [FirstLoading(curve, 0.0, ()) for curve in curves]
    groups = compare_tests(calibration, {"A2": wire_of("A2")}, loadings)
    return CalibrationStudy(Path("processed/calibration"), calibration, groups, {}, ())


def test_calibrate_leaves_out_rejected_tests(
    fitted: CalibrationStudy, monkeypatch: pytest.MonkeyPatch, run: Run
) -> None:
    folder = Path("processed/A2")
    first_file, second_file = (folder / name / "result.h5" for name in ("A2-1", "A2-2"))
    calls: list[object] = []
    monkeypatch.setattr("labpipe.cli.calibrate.find_results", lambda _: [first_file, second_file])

    def take(targets: object, **_: object) -> CalibrationStudy:
        calls.append(targets)
        return fitted

    monkeypatch.setattr("labpipe.cli.calibrate.calibrate_tests", take)
    for rejected, targets in (({}, [folder]), ({first_file: "slipped (A. Tester)"}, [second_file])):
        monkeypatch.setattr(
            "labpipe.cli.calibrate.exclude_rejected_tests", lambda _, r=rejected: ([second_file], r)
        )
        ran = run("calibrate", folder)
        assert (ran.status, calls[-1]) == (EXIT_OK, targets)
    assert ran.err == f"labpipe calibrate: rejected: {first_file.parent}: slipped (A. Tester)\n"


def model_lines(*tables: WireTable, refused: dict[str, str] | None = None) -> list[str]:
    modelled = ModelledWires(Path("wires.xlsx"), Path("processed/wires"), tables, refused or {}, ())
    return format_wire_models(modelled).splitlines()


def test_table_of_bundles(approved: Approve) -> None:
    offered = (Conduit(3e-3, 1.05, False), Conduit(5e-3, 0.38, True))
    lines = [*bundle_lines(B1=7), *bundle_lines(*offered, bore=5e-3, B1=4, B2=3)]
    lines += bundle_lines(B1=2)
    approved(re.sub(r"\(\d+ deg from x\)", "(# deg from x)", line) for line in lines)


def test_table_of_wires(approved: Approve) -> None:
    """A curve that ends early, slip at once and beyond the range, notes of some and of all."""
    table = wire_table("A2")
    defaults = QualityNote("defaults_taken", Severity.INFO, "sheet", "poisson 0.34 taken")
    cut = QualityNote("cantilever_cut", Severity.WARNING, "cantilever", "it stops")
    short = replace(table, tip_deflection=table.tip_deflection[:3], tip_force=table.tip_force[:3])
    unusual = (
        short,
        replace(table, slip_onsets=np.zeros(1)),
        replace(table, slip_onsets=np.array([np.inf])),
    )
    numerous = [
        replace(table, name=f"W{number}", notes=(defaults, cut) if number < 12 else (defaults,))
        for number in range(13)
    ]
    approved([*model_lines(*unusual, refused={"X1": "too thick"}), *model_lines(*numerous)])


def test_table_of_a_calibration(fitted: CalibrationStudy, approved: Approve) -> None:
    """Digits of fitted values are left out."""
    first, second, third = fitted.calibration.parameters
    (group,) = fitted.groups
    reason = Reason("no_prediction", "too deep")
    failed = replace(group, prediction=None, errors=None, reason=reason)
    note = QualityNote("test_doubtful", Severity.WARNING, "T1", "taken as it is: gap")
    silent = replace(first, value=float("nan"), intervals=(), verdict=Identifiability.FIXED)
    parts = (Interval(0.6, 1.8), Interval(4.0, 9.0))
    two_parts = replace(third, intervals=parts, verdict=Identifiability.TWO_SOLUTIONS)
    unusual = (
        (replace(first, is_open_below=True), second, replace(third, intervals=())),
        (silent, second, two_parts),
    )
    texts = [format_calibration(fitted), format_calibration(replace(fitted, groups=(failed,)))]
    for parameters in unusual:
        calibration = replace(fitted.calibration, parameters=parameters, notes=(note,), n_samples=1)
        texts.append(format_calibration(replace(fitted, calibration=calibration)))
    prior = ParameterChoice(1.1, factor=1.2, source="tensile tests of strands")
    with_prior = calibrate(wire_of("A2"), measured("A2"), Settings({"copper_scale": prior}))
    assert isinstance(with_prior, Calibration)
    texts.append(format_calibration(replace(fitted, calibration=with_prior)))
    lines = [
        re.sub(r"\d[\d.]*( x 10\^?[-\d]+|e[-+]\d+)?", "#", " ".join(line.split()))
        for text in texts
        for line in text.splitlines()
    ]
    curves = [external_comparison("n" * 40), external_comparison(), untested(), unmodelled()]
    compared = format_calibration(replace(fitted, comparisons=tuple(curves))).splitlines()
    approved([*lines, *compared[-9:]])
