"""Tension tests with an extensometer against Ramberg-Osgood curves, whose numbers are known.

``strain = stress / E + 0.2 % (stress / Rp)^12``: the 0.2 % proof stress is Rp by definition.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pytest

from labpipe.process.story import reduce_recordings
from labpipe.protocol.load import parse_protocol
from labpipe.records.arrays import Floats
from labpipe.records.causes import LENGTH
from labpipe.records.estimates import UnavailableError
from labpipe.records.recording import Channel, Clock, Recording
from labpipe.records.result import Result, Status
from labpipe.records.signals import Signals
from labpipe.results.kinds import ReducedTest, Setup
from labpipe.results.stiffness import compute_area
from labpipe.results.tension import TensileCurve, _list_line_doubts, get_gauge_length

MODULUS, PROOF, GAUGE, AREA = 200e9, 400e6, 25e-3, 20e-6
PROTOCOL = """\
version: 1
name: p
sources:
  frame:
    reader: load-frame
    channels:
      force: {channel: A, scale_uncertainty: 0.29 %}
      displacement: {channel: B, unit: mm}
      extension: {channel: C, scale_uncertainty: 0.29 %}
specimen: {gauge_length: 25 mm, section: {area: 20 mm^2}}
limits: {rest_force: 2 %}
curve:
  force: force
  displacement: extension
  failure: {force_below: 50 %, at_end_below: 85 %}
  elastic_line: {LINE}
branches: {channel: displacement, min_stroke: 0.2 mm}
results:
  - {result: elastic-modulus}
  - {result: proof-stress, name: proof, offset: 0.2 %}
  - {result: yield-stress}
  - {result: tensile-strength}
  - {result: elongation-at-maximum-force}
  - {result: elongation-at-break}
"""


@dataclass(frozen=True)
class Pulled:
    """A pull at 5 samples per second: s, N, m and m."""

    time: Floats
    force: Floats
    extension: Floats
    travel: Floats


def steel(seed: int = 0) -> Pulled:
    """Pull a specimen that necks from 10 % of strain on, to 75 % of its largest force at 15 %."""
    random, count = np.random.default_rng(seed), 800
    strain = np.concatenate([np.linspace(0.0, 0.004, 200), np.linspace(0.004, 0.15, count - 200)])
    stresses = np.linspace(0.0, 650e6, 20_001)
    strains = stresses / MODULUS + 0.002 * (stresses / PROOF) ** 12
    necked = np.clip((strain - 0.10) / 0.05, 0.0, 1.0)
    force = np.interp(np.minimum(strain, 0.10), strains, stresses) * AREA * (1 - 0.25 * necked**2)
    extension = strain * GAUGE
    return Pulled(
        np.arange(count) / 5.0,
        force + random.normal(0.0, 3.0, count),
        extension + random.normal(0.0, 3e-8, count),
        1.3 * extension + 4e-8 * force,
    )


def measure_replicates(
    pulled: Pulled, line: str = "straight: 99.98 %", gauge: str = "25 mm"
) -> dict[str, Result]:
    """Reduce a pull by the protocol above."""
    units = {"force": ("A", "N"), "displacement": ("B", "m"), "extension": ("C", "m")}
    values = {"force": pulled.force, "displacement": pulled.travel, "extension": pulled.extension}
    channels = tuple(
        Channel(name, path, values[name], unit=unit) for name, (path, unit) in units.items()
    )
    clocks = (Clock("time", pulled.time),)
    recording = Recording("load-frame", clocks=clocks, channels=channels)
    protocol = parse_protocol(PROTOCOL.replace("LINE", line).replace("25 mm", gauge), "p.yaml")
    return {x.name: x for x in reduce_recordings({"frame": recording}, protocol).results}


def test_numbers_are_those_of_the_curve_and_intervals_hold_them() -> None:
    truth = {"elastic_modulus": MODULUS, "proof": PROOF}
    is_inside = dict.fromkeys(truth, 0)
    for seed in range(20):
        results = measure_replicates(steel(seed))
        for name, value in truth.items():
            result = results[name]
            assert result.value == pytest.approx(value, rel=0.02)
            assert result.interval is not None
            is_inside[name] += result.interval.lower <= value <= result.interval.upper
    assert min(is_inside.values()) >= 18


def test_strength_and_elongations_are_those_of_samples() -> None:
    pulled = steel()
    results = measure_replicates(pulled)
    last, peak = len(pulled.force) - 1, int(np.argmax(pulled.force))
    strain = pulled.extension / GAUGE
    assert results["tensile_strength"].value == pytest.approx(pulled.force.max() / AREA)
    for name, sample in (("maximum_force", peak), ("break", last)):
        total = results[f"elongation_at_{name}"].value
        plastic = results[f"plastic_elongation_at_{name}"].value
        assert total == pytest.approx(strain[sample], abs=1e-4)
        assert total is not None
        assert plastic == pytest.approx(total - pulled.force[sample] / AREA / MODULUS, abs=1e-4)
    assert [x.code for x in results["upper_yield_stress"].reasons] == ["no_yield_point"]


@pytest.mark.parametrize(
    "line", ["from: 0.05 %, to: 0.12 %", "{from: 5 %, to: 40 %, of: strength}", "straight: 99.99 %"]
)
def test_a_stated_window_gives_the_modulus_too(line: str) -> None:
    modulus = measure_replicates(steel(), line.strip("{}"))["elastic_modulus"]
    assert modulus.value == pytest.approx(MODULUS, rel=0.01)
    assert modulus.method.startswith("slope of the elastic line")
    assert ("from" in modulus.method) is ("from" in line)  # one mean for all searched lines
    assert modulus.remark.endswith("MPa")


def test_a_gauge_length_known_to_one_percent_is_one_percent_of_the_modulus() -> None:
    gauge = "25 mm, uncertainty: {gauge_length: 0.25 mm}"
    modulus = measure_replicates(steel(), gauge=gauge)["elastic_modulus"]
    (change,) = (part.change for part in modulus.budget if part.cause == LENGTH)
    assert change == pytest.approx(0.01 * (modulus.value or 0.0))


@pytest.mark.parametrize(("above", "codes"), [(5e6, []), (7e6, ["above_elastic_line"])])
def test_a_curve_above_its_elastic_line_by_six_times_the_noise_is_doubtful(
    above: float, codes: list[str]
) -> None:
    """One sample beyond a line up to 200 MPa, of which 1 % are less than six times 1 MPa."""
    strain = np.linspace(0.0, 0.002, 201)
    stress = MODULUS * strain + above * (np.arange(201) == 150)
    pull = TensileCurve(strain, strain, stress, slice(0, 101), "", 1e6, 0.0)
    line = replace(pull, slope=MODULUS, mean_strain=0.0005, mean_stress=MODULUS * 0.0005)
    test = ReducedTest(Signals(), setup=Setup(sizes={"gauge_length": GAUGE}))
    doubts = _list_line_doubts(test, line, lambda pull: pull.slope)
    assert [doubt.code for doubt in doubts] == codes


def with_extension(change: Callable[[Floats], Floats]) -> Callable[[Pulled], Pulled]:
    return lambda pulled: replace(pulled, extension=change(pulled.extension.copy()))


def shifted(at: int, by: float) -> Callable[[Pulled], Pulled]:
    def change(extension: Floats) -> Floats:
        extension[at:] += by
        return extension

    return with_extension(change)


def ended(at: int, value: float) -> Callable[[Pulled], Pulled]:
    def change(extension: Floats) -> Floats:
        extension[at:] = value
        return extension

    return with_extension(change)


def cut(count: int) -> Callable[[Pulled], Pulled]:
    return lambda x: Pulled(x.time[:count], x.force[:count], x.extension[:count], x.travel[:count])


def looped(at: int) -> Callable[[Pulled], Pulled]:
    """Unload to half of the force along the modulus, and load again."""

    def change(pulled: Pulled) -> Pulled:
        force, extension, travel = pulled.force, pulled.extension, pulled.travel
        fall = np.concatenate([np.linspace(0.0, 0.5, 40), np.linspace(0.5, 0.0, 40)]) * force[at]
        back = fall * GAUGE / AREA / MODULUS
        loops = (force[at] - fall, extension[at] - back, travel[at] - 1.3 * back - 4e-8 * fall)
        records = [
            np.insert(record, at + 1, loop)
            for record, loop in zip((force, extension, travel), loops, strict=True)
        ]
        return Pulled(np.arange(len(records[0])) / 5.0, *records)

    return change


def slipped(pulled: Pulled) -> Pulled:
    """Slip in the grips at half of the proof stress: force and strain fall and come back."""
    start = int(np.argmax(pulled.force > 0.5 * PROOF * AREA))
    fallen, back = slice(start, start + 10), slice(start + 10, start + 20)
    force, extension, travel = pulled.force.copy(), pulled.extension.copy(), pulled.travel.copy()
    for part, share in ((fallen, np.full(10, 0.9)), (back, np.linspace(0.9, 1.0, 10))):
        extension[part] += (share - 1.0) * pulled.force[start] * GAUGE / AREA / MODULUS
        force[part] += (share - 1.0) * pulled.force[start]
    return Pulled(pulled.time, force, extension, travel)


@pytest.mark.parametrize("at", [80, 350, 600])
def test_numbers_of_a_pull_with_an_unloading_loop_are_those_without(at: int) -> None:
    plain, loop = measure_replicates(steel()), measure_replicates(looped(at)(steel()))
    for name, result in plain.items():
        if result.value is not None:
            assert loop[name].value == pytest.approx(result.value, rel=0.003), name


def test_a_slip_in_the_grips_is_no_yield_point() -> None:
    result = measure_replicates(slipped(steel()))["upper_yield_stress"]
    assert [reason.code for reason in result.reasons][:1] == ["no_yield_point"]


@pytest.mark.parametrize(
    ("change", "codes"),
    [
        (shifted(90, 5e-6), {"proof": "strain_jumps", "tensile_strength": ""}),
        (shifted(90, -5e-6), {"proof": "strain_jumps", "elastic_modulus": "above_elastic_line"}),
        (shifted(150, 4e-5), {"proof": "strain_jumps", "tensile_strength": ""}),
        (ended(90, np.nan), {"proof": "not_reached", "tensile_strength": ""}),
        (ended(600, np.nan), {"elongation_at_break": "extensometer_off", "proof": ""}),
        (ended(90, 0.0), {"proof": "not_reached", "elastic_modulus": "zero_jump"}),
        (with_extension(lambda x: 2.0 * x), {"elastic_modulus": "extension_exceeds_travel"}),
        (
            with_extension(lambda x: np.where(x > 0.06 * GAUGE, x[::-1] * 1e-3 + 0.06 * GAUGE, x)),
            {"elongation_at_maximum_force": "extensometer_off", "tensile_strength": ""},
        ),
        (cut(500), {"tensile_strength": "ends_at_peak", "proof": ""}),
        (cut(120), {"tensile_strength": "ends_at_peak", "proof": "not_reached"}),
    ],
    ids=[
        "jump",
        "slip",
        "jump-onto-the-shifted-line",
        "off-elastic",
        "off-plastic",
        "fallen",
        "wrong-unit",
        "taken-off-and-held",
        "cut",
        "cut-elastic",
    ],
)
def test_bad_records(change: Callable[[Pulled], Pulled], codes: dict[str, str]) -> None:
    results = measure_replicates(change(steel()))
    for name, code in codes.items():
        result = results[name]
        if code:
            assert code in {reason.code for reason in result.reasons}, (name, result.reasons)
            assert result.status is not Status.OK
        else:
            assert result.status is Status.OK, (name, result.reasons)


def hardened_in_a_line(pulled: Pulled) -> Pulled:
    """Yield at 350 MPa with a kink, then harden in a line until the specimen necks."""
    strain = np.minimum(pulled.extension / GAUGE, 0.10)
    stress = np.minimum(MODULUS * strain, 350e6 + 1e9 * (strain - 350e6 / MODULUS))
    necked = np.clip((pulled.extension / GAUGE - 0.10) / 0.05, 0.0, 1.0)
    return replace(pulled, force=stress * AREA * (1.0 - 0.25 * necked**2))


@pytest.mark.parametrize("change", [lambda pulled: pulled, hardened_in_a_line])
@pytest.mark.parametrize(
    "read",
    [
        lambda x: x + np.random.default_rng(0).normal(0.0, 3e-7, len(x)),
        lambda x: x + np.random.default_rng(1).normal(0.0, 1e-6, len(x)),
        lambda x: 1e-6 * np.round(1e6 * x),
        lambda x: 3e-6 * np.round(x / 3e-6),
    ],
    ids=["noise-0.3um", "noise-1um", "steps-1um", "steps-3um"],
)
def test_a_rough_extensometer_leaves_the_elastic_line(
    change: Callable[[Pulled], Pulled], read: Callable[[Floats], Floats]
) -> None:
    results = measure_replicates(with_extension(read)(change(steel())))
    modulus = results["elastic_modulus"]
    assert modulus.interval is not None
    is_inside = modulus.interval.lower <= MODULUS <= modulus.interval.upper
    assert is_inside or modulus.status is Status.DOUBTFUL
    assert modulus.value == pytest.approx(MODULUS, rel=0.1)
    for name in ("proof", "elongation_at_maximum_force", "elongation_at_break"):
        assert results[name].status is Status.OK, (name, results[name].reasons)


def test_a_jump_of_the_strain_is_told_with_its_stress() -> None:
    pulled = steel()
    last = f"{1e-6 * pulled.force[89] / AREA:.4g} MPa"
    pulled.extension[20:30] = np.nan
    reasons = measure_replicates(shifted(90, 5e-6)(pulled))["proof"].reason_text
    assert f"strain_jumps: the strain jumps by +0.022% at {last}" in reasons


@pytest.mark.parametrize(
    ("sizes", "area"),
    [
        ({"area": 5e-6, "width": 1.0, "thickness": 1.0}, 5e-6),
        ({"width": 0.02, "thickness": 0.006}, 1.2e-4),
        ({"outer_diameter": 0.01, "inner_diameter": 0.008}, 2.8274334e-5),
        ({"outer_diameter": 0.01, "wall": 0.001}, 2.8274334e-5),
        ({"outer_diameter": 0.01}, 7.8539816e-5),
    ],
)
def test_areas(sizes: dict[str, float], area: float) -> None:
    assert compute_area(sizes) == pytest.approx(area)


def test_sizes_that_are_missing() -> None:
    with pytest.raises(UnavailableError) as no_area:
        compute_area({"width": 0.02})
    assert no_area.value.failure.code == "no_area"
    with pytest.raises(UnavailableError) as no_length:
        get_gauge_length({"area": 5e-6})
    assert no_length.value.failure.code == "no_length"
    assert get_gauge_length({"length": 0.1, "gauge_length": 0.05}) == 0.05
