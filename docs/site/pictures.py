"""Draw the pictures of the documentation.

``python -m docs.site.pictures FOLDER [NAME ...]`` draws all of them, or the named ones. Commands of
labpipe draw most of them. The others are drawn here as figures of labpipe, ``mujoco-loop`` with
MuJoCo: wires are those of the examples, synthetic tests and lines those of the studies in
``tests/coverage``. ``report-page`` is a screenshot by Chromium.
"""

from __future__ import annotations

import subprocess
import sys
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from io import BytesIO
from itertools import chain, pairwise
from pathlib import Path
from typing import NamedTuple

import numpy as np
from PIL import Image

from labpipe.cli.demo import CAMPAIGNS
from labpipe.mechanics.decks.mujoco_sliders import format_plane_deck
from labpipe.mechanics.law.loss_card import make_loss_card
from labpipe.mechanics.law.sliders import SliderLaw, compute_first_loading, fit_sliders
from labpipe.mechanics.law.thinning import make_concave_law
from labpipe.mechanics.rod.bands import Band, compute_node_curvature
from labpipe.mechanics.rod.path import RodPath
from labpipe.mechanics.studies.harness_line import make_section_function
from labpipe.mechanics.studies.wire_sheets import read_wire_sheet
from labpipe.mechanics.wire.calibration.calibrate_wire import Settings, calibrate
from labpipe.mechanics.wire.cantilever import bend_to_deflection, bend_under_force, make_straight
from labpipe.mechanics.wire.first_loading import compute_end_load_path
from labpipe.mechanics.wire.wire_table import tabulate_wire
from labpipe.protocol.load import find_shipped_folder
from labpipe.records.arrays import Floats
from labpipe.records.wire import PARAMETERS, Calibration, WireTable
from labpipe.report.calibration_report import make_profile_plot
from labpipe.report.figure_page import draw_page, use_style
from labpipe.report.plot_records import (
    Axis,
    Label,
    Line,
    Page,
    Plot,
    join_with_gaps,
    make_area,
    make_line,
)
from labpipe.report.wording import Scale
from labpipe.units import GRAVITY
from labpipe.virtual_lab import ChosenTests, simulate_campaigns
from tests.coverage import drawn_lines, predicted_lines, wire_campaigns
from tests.judges.rod_references import tips
from tests.listings import ROOT, find_commands, folder_of, is_run, run

WIDTH = 900
"""Width of a picture that is drawn here, pixels."""
RESOLUTION = 180.0
"""Resolution of a picture that a command of labpipe draws, dots per inch."""
LENGTH, SMALL_LENGTH, PERCENT = Scale(1e3, "mm"), Scale(1e6, "µm"), Scale(100.0, "%")
CURVATURE, MOMENT, FORCE = Scale(1.0, "1/m"), Scale(1e3, "N·mm"), Scale(1e3, "mN")


def tabulate_example(name: str) -> WireTable:
    """Tabulate a wire of the example sheet.

    Parameters
    ----------
    name : name of the wire, such as ``A2``
    """
    sheet = read_wire_sheet(find_shipped_folder("examples") / "wires.xlsx")
    return tabulate_wire(sheet.find_wire(name, ""))


def make_two_valleys() -> Page:
    """Make the picture of a calibration with two solutions: the profiles of its parameters."""
    kind = wire_campaigns.WireKind("own", "A3", 120, noise=2.0, campaigns=0)
    _, curves = wire_campaigns.campaign(kind, 31003)
    wire, settings = wire_campaigns.wire_of(kind.wire), Settings(gain=wire_campaigns.GAIN)
    calibration = calibrate(wire, curves, settings)
    assert isinstance(calibration, Calibration)
    panels = [
        make_profile_plot(parameter, f"{heading}: {parameter.verdict}")
        for parameter, heading in zip(
            calibration.parameters, ("friction", "insulation", "copper"), strict=True
        )
    ]
    title = "A3, 120 mm  ·  calibration of the wire model  ·  3 samples"
    return Page("two-valleys", title, panels, height=50.0, width=165.0, columns=3)


def make_sliders() -> Page:
    """Make the picture of a law as a spring and sliders, and of the errors of four forms of law."""
    first, last, shown = 0.1, 10.0, 1.5  # 1/m
    table = tabulate_example("C4")
    curvature = np.append(0.0, np.geomspace(first, last, 400))
    moment = np.interp(curvature, table.curvature, table.moment)
    laws = [fit_sliders(curvature, moment, count) for count in (4, 6, 12)]
    x = np.linspace(0.0, shown, 400)
    lines, labels = _stack_sliders(laws[1], x)
    lines.append(make_line("mean c0", x, np.interp(x, table.curvature, table.moment), label="law"))
    slips = laws[1].slip_curvatures[laws[1].slip_curvatures < shown]
    corners = slips, compute_first_loading(laws[1], slips)
    lines.append(make_line("mark_pin", *corners, markersize=3.0, label="a slider begins to slip"))
    axes = Axis("Curvature", CURVATURE, 0.0, shown), Axis("Moment", MOMENT, 0.0)
    panels = [Plot(*axes, lines, "moment of a spring and six sliders", labels)]
    card = make_loss_card(curvature, moment, laws)
    x, decay = curvature[1:], card.dahl_law.decay
    moments = {
        "constant stiffness": card.stiffness * x,
        "Dahl's law": card.dahl_law.stiffness * x - card.dahl_law.moment * np.expm1(-x / decay),
        "4 sliders": compute_first_loading(laws[0], x),
        "12 sliders": compute_first_loading(laws[2], x),
    }
    errors = [
        make_line("wire", x, np.abs(values / moment[1:] - 1.0), color=f"C{number}", label=label)
        for number, (label, values) in enumerate(moments.items(), start=1)
    ]
    axes = (
        Axis("Curvature", CURVATURE, first, last, is_log=True),
        Axis("Error of the moment", PERCENT, 1e-4, 1.0, is_log=True),
    )
    panels.append(Plot(*axes, errors, "errors of four forms of law"))
    return Page("sliders", "C4  ·  law as sliders", panels, height=58.0, width=130.0)


def _stack_sliders(law: SliderLaw, curvature: Floats) -> tuple[list[Line], list[Label]]:
    """Stack the moments of the spring and of each slider of a law, with labels."""
    parts = law.slider_stiffnesses * np.minimum(curvature[:, None], law.slip_curvatures)
    columns = 0.0 * curvature, law.spring_stiffness * curvature, parts[:, ::-1]
    edges = np.cumsum(np.column_stack(columns), axis=1).T
    shades = map(str, np.linspace(0.6, 0.95, len(edges) - 1).tolist())
    areas = [
        make_area("between_bounds", curvature, *pair, color=shade, edgecolor="white", linewidth=0.5)
        for pair, shade in zip(pairwise(edges), shades, strict=True)
    ]
    middle = len(curvature) // 2
    heights = {"spring": 0.4 * edges[1, middle], "sliders": 0.85 * edges[-1, middle]}
    return areas, [Label(name, curvature[middle], y) for name, y in heights.items()]


def make_mujoco_loop() -> Page:
    """Make the picture of two cycles of cantilevers: those of labpipe, and decks in MuJoCo."""
    length, deepest = 0.085, 0.05  # m
    up, down = np.linspace(0.2, 1.0, 5), np.linspace(0.85, 0.0, 6)
    fractions = np.concatenate([np.linspace(0.1, 1.0, 8), down, up, down, up])
    panels = []
    for name in ("A2", "C4"):
        table = tabulate_example(name)
        law = make_concave_law(table.curvature[1:], table.moment[1:])
        bent = bend_to_deflection(law, make_straight(law), length, deepest)
        residual = bend_under_force(law, bent.state, length, np.zeros(2)).y[-1]
        loading, unloading = np.linspace(0.0, deepest, 100), np.linspace(deepest, residual, 80)
        deflection = np.concatenate([loading[1:], unloading[1:], unloading[-2::-1]])
        load = compute_end_load_path(law, length, deflection).load
        loads = load[-1] * fractions
        tip = tips(format_plane_deck(table, length=length), loads)[:, 1]
        curve = np.append(0.0, deflection), np.append(0.0, load)
        lines = [
            make_line("mean c0", *curve, label="labpipe"),
            make_line("mark_pin", tip, loads, color="C1", label="MuJoCo, tip at rest"),
        ]
        axes = Axis("Tip deflection", LENGTH, 0.0, 1.04 * deepest), Axis("End load", FORCE, 0.0)
        panels.append(Plot(*axes, lines, name))
    title = "Cantilevers of 85 mm  ·  two cycles"
    return Page("mujoco-loop", title, panels, height=58.0, width=130.0)


def make_rod_bands() -> Page:
    """Make the picture of two lines with bands, and of draws that were each solved."""
    seed = 41039
    headings_by_kind = {
        "push": ("with an end load", "unloaded", "curvature with an end load"),
        "bow": ("held by a gripper", "released", "curvature when held"),
    }
    panels = []
    for kind in drawn_lines.KINDS[:2]:
        drawn, known = drawn_lines.draw(kind, seed), predicted_lines.known_of(seed)
        bands = predicted_lines.predicted(kind, drawn, known)
        assert bands is not None
        paths = list(solve_draws(kind, drawn, known.calibration))
        *headings, last_heading = headings_by_kind[kind.name]
        bent, _ = bands.states
        states = [[path.states[state.step] for path in paths] for state in bands.states]
        for heading, state, drawn_states in zip(headings, bands.states, states, strict=True):
            shapes = [drawn_state.positions for drawn_state in drawn_states]
            panels.append(_make_shape_plot(heading, state.positions, shapes))
        curvatures = [compute_node_curvature(state.curvature_vectors) for state in states[0]]
        panels.append(_make_curvature_plot(last_heading, bent.curvature, curvatures))
    title = f"{drawn.wire}  ·  lines with bands"
    return Page("rod-bands", title, panels, height=104.0, width=150.0, columns=3)


def solve_draws(
    kind: drawn_lines.LineKind, drawn: drawn_lines.Drawn, calibration: Calibration
) -> Iterator[RodPath]:
    """Solve a line for 40 draws of its inputs.

    Parameters
    ----------
    kind, drawn : line of the study of coverage
    calibration : calibration of its wire

    Yields
    ------
    The path of each draw that has an equilibrium.
    """
    distribution = predicted_lines.beliefs_of(kind, drawn, calibration)[0]
    values = dict(zip(PARAMETERS, calibration.solutions[0].values.tolist(), strict=True))
    build_section = make_section_function(predicted_lines.spec_of(drawn.wire), values)
    for amounts in distribution.amounts[:40]:
        path = predicted_lines.path_of(kind, drawn, build_section, distribution.to_inputs(amounts))
        if path.status != "failed":
            yield path


def _list_draws(x: Sequence[Floats], y: Sequence[Floats]) -> Iterator[Line]:
    for draw in zip(x, y, strict=True):
        yield make_line("earlier_step", *draw, linewidth=0.4, label="draw")


def _make_shape_plot(heading: str, band: Band, shapes: Sequence[Floats]) -> Plot:
    """Make the panel of a shape with the bands of its nodes in x and z."""
    lines = list(_list_draws([shape[:, 0] for shape in shapes], [shape[:, 2] for shape in shapes]))
    (x, _, z), (left, _, low), (right, _, high) = (
        ends.T for ends in (band.value, band.lower, band.upper)
    )
    bars = np.hstack(
        [
            (join_with_gaps(left, right), join_with_gaps(z, z)),
            (join_with_gaps(x, x), join_with_gaps(low, high)),
        ]
    )
    lines.append(make_line("last_step", *bars, color="C0", label="95 % band, pointwise"))
    lines.append(make_line("last_step", x, z, label="best values"))
    return Plot(Axis("x", LENGTH), Axis("z", LENGTH), lines, heading, is_to_scale=True)


def _make_curvature_plot(heading: str, band: Band, curvatures: Sequence[Floats]) -> Plot:
    """Make the panel of the curvature along the line with its band."""
    fraction = np.linspace(0.0, 1.0, len(band.value))
    lines = [make_area("harness_band", fraction, band.lower, band.upper)]
    lines += _list_draws([fraction] * len(curvatures), curvatures)
    lines += [make_line("edge_of_band", fraction, edge) for edge in (band.lower, band.upper)]
    lines.append(make_line("last_step", fraction, band.value))
    x_axis = Axis("Fraction of the length", Scale(1.0, ""), 0.0, 1.0)
    return Plot(x_axis, Axis("Curvature", CURVATURE, 0.0), lines, heading)


def make_wires_at_rest() -> Page:
    """Make the picture of the sag of wires at rest, and of what their weight adds to the load."""
    deflection = np.geomspace(3.5e-4, 0.05, 60)
    sags, increases = list[Line](), list[Line]()
    for number, (name, length) in enumerate((("A2", 0.085), ("B1", 0.1), ("A3", 0.12))):
        table = tabulate_example(name)
        law = make_concave_law(table.curvature[1:], table.moment[1:])
        weight, label = GRAVITY * table.mass_per_length, f"{name}, {1e3 * length:.0f} mm"
        rest = bend_to_deflection(law, make_straight(law, self_weight=weight), length, 0.0)
        with_weight, without = (
            compute_end_load_path(law, length, deflection, self_weight=value).load
            for value in (weight, 0.0)
        )
        look = f"mean c{number}"
        sags.append(make_line(look, rest.x, rest.y, label=label))
        increases.append(make_line(look, deflection, with_weight / without - 1.0, label=label))
    along, height = Axis("Along the clamped axis", LENGTH), Axis("Height", SMALL_LENGTH)
    tip = Axis("Tip deflection", LENGTH, deflection[0], deflection[-1], is_log=True)
    increase = Axis("Increase", PERCENT, 0.0)
    panels = [
        Plot(along, height, sags, "sag at rest"),
        Plot(tip, increase, increases, "increase of the reading by weight"),
    ]
    return Page("wires-at-rest", "Wires at rest  ·  wire model", panels, height=52.0, width=120.0)


def photograph_report() -> Image.Image:
    """Photograph the first screen of a report on the tubes of the demo."""
    campaigns = CAMPAIGNS["tensile"]
    names = (test.name for campaign in campaigns for test, _ in campaign.list_scenarios())
    tubes = tuple(name for name in names if name.startswith(("CT-", "twist-tube-")))
    options = "--headless", "--no-sandbox", "--hide-scrollbars", "--window-size=1400,1050"
    with folder_of(""):
        simulate_campaigns([ChosenTests(campaigns, tubes)], Path("raw/tubes"))
        run("labpipe process raw/tubes --no-figures")
        run('labpipe report processed/tubes --title "Synthetic tubes"')
        file, report = Path("report.png").resolve(), Path("processed/tubes/report/report.html")
        command = ["chromium", *options, f"--screenshot={file}", report.resolve().as_uri()]
        subprocess.run(command, check=True, capture_output=True)
        return Image.open(file).convert("RGB")


PICTURES: Mapping[str, Callable[[], Page | Image.Image]] = {
    "two-valleys": make_two_valleys,
    "sliders": make_sliders,
    "mujoco-loop": make_mujoco_loop,
    "rod-bands": make_rod_bands,
    "wires-at-rest": make_wires_at_rest,
    "report-page": photograph_report,
}
"""Pictures that no command of labpipe draws alone."""


class Figures(NamedTuple):
    """Pictures that commands of labpipe draw.

    Parameters
    ----------
    page : page of the documentation in whose working folder the commands run, after its own
    commands : further commands
    files : file of each picture
    """

    page: str
    commands: Sequence[str]
    files: Mapping[str, str]


_HARNESS, _DEMO = "processed/harness", "processed/demo/one-of-each"
_WIRE = f"{_DEMO}/A2-085-1/figures"
FIGURES = (
    Figures(
        "docs/how-to/harness.md",
        [f"labpipe harness examples/harness-{name}.yaml" for name in ("push", "chain")],
        {
            "wire-sections": "processed/wires/figures/sections-1.png",
            "wire-comparison": "processed/wires/figures/comparison-1.png",
            "wire-moment": "processed/wires/figures/A2.moment.png",
            "harness-slack": f"{_HARNESS}/harness-slack/figures/harness-sweep.png",
            "harness-bundle": f"{_HARNESS}/harness-bundle/figures/harness.png",
            "harness-push": f"{_HARNESS}/harness-push/figures/harness.png",
            "harness-chain": f"{_HARNESS}/harness-chain/figures/harness.png",
        },
    ),
    Figures(
        "docs/explanations/bundle-model.md",
        ["labpipe demo"],
        {
            "bundle": "processed/bundles/10-B1-9-B2-asymmetric/figures/bundle.png",
            "bundle-loop": "processed/bundles/TWB-B1-19-PVC-1/figures/bundle-loop.png",
            "force-displacement": f"{_WIRE}/force-displacement.png",
            "wire-shapes": f"{_WIRE}/wire-shapes.png",
            "timeline": f"{_WIRE}/timeline.png",
            "marker-quality": f"{_WIRE}/marker-quality.png",
            "uncertainty-budget": f"{_WIRE}/uncertainty-budget.png",
            "slips": f"{_DEMO}/CT-10-slit-2/figures/stiffness-lines.png",
            "stiffness-lines": f"{_DEMO}/twist-tube-1a/figures/stiffness-lines.png",
        },
    ),
    Figures(
        "docs/tutorials/first-tensile-test.md",
        [],
        {"report-numbers": "processed/TT/report/figures/twist-tube-10-numbers.png"},
    ),
    Figures(
        "docs/tutorials/first-bundle.md",
        [],
        {
            "report-taping": "processed/taping/report/figures/"
            "difference-taping-19-b2-corrugated-tube-span-152-4-mm.png"
        },
    ),
    Figures(
        "docs/tutorials/tour.md",
        [],
        {"validation": "processed/demo/wires/calibration/figures/validation-1.png"},
    ),
)
"""Pictures that commands of labpipe draw, by page."""
_PNG_OPTIONS = {"report": "--figures png"} | dict.fromkeys(
    ("bundle", "calibrate", "demo", "harness", "model"), "--png"
)


def draw_figures(figures: Figures, folder: Path, names: Iterable[str]) -> None:
    """Run the commands of a page of the documentation, and save figures that they draw.

    Parameters
    ----------
    figures : page, commands and files
    folder : existing folder of the pictures
    names : names of the pictures that are saved
    """
    folder, text = folder.resolve(), (ROOT / figures.page).read_text(encoding="utf-8")
    lines = [command.line for command in find_commands(text) if is_run(command.line)]
    with folder_of(figures.page):
        for line in (*lines, *figures.commands):
            option = _PNG_OPTIONS.get(line.split()[1], "")
            run(f"{line.replace(' --no-figures', '')} {option}")
        for name in names:
            image = Image.open(figures.files[name])
            scale = RESOLUTION / image.info["dpi"][0]
            size = round(scale * image.width), round(scale * image.height)
            save_picture(image.resize(size, Image.Resampling.LANCZOS), folder / f"{name}.png")


def save_picture(picture: Page | Image.Image, path: Path) -> None:
    """Save a picture as a PNG with a palette.

    Parameters
    ----------
    picture : page, which is drawn, or image
    path : path of the file
    """
    image = draw_image(picture) if isinstance(picture, Page) else picture.convert("RGB")
    palette = image.quantize(128, Image.Quantize.MAXCOVERAGE, kmeans=1, dither=Image.Dither.NONE)
    palette.save(path, optimize=True)


def draw_image(page: Page) -> Image.Image:
    """Draw a page with a width of `WIDTH`.

    Parameters
    ----------
    page : contents of the picture
    """
    file = BytesIO()
    with use_style():
        draw_page(page).savefig(file, format="png", dpi=25.4 * WIDTH / page.width)
    return Image.open(file).convert("RGB")


def draw_pictures(folder: Path, names: Collection[str] = ()) -> None:
    """Draw pictures of the documentation.

    Parameters
    ----------
    folder : existing folder of the pictures
    names : names of the pictures, without the ending; all if empty

    Raises
    ------
    ValueError
        If there is no picture of a name.
    """
    every_name = [*PICTURES, *chain.from_iterable(figures.files for figures in FIGURES)]
    if unknown := set(names) - set(every_name):
        message = f"names={sorted(unknown)}: expected {', '.join(every_name)}"
        raise ValueError(message)
    wanted_names = names or every_name
    for name, make_picture in PICTURES.items():
        if name in wanted_names:
            save_picture(make_picture(), folder / f"{name}.png")
    for figures in FIGURES:
        if names_on_page := [name for name in figures.files if name in wanted_names]:
            draw_figures(figures, folder, names_on_page)


if __name__ == "__main__":
    draw_pictures(Path(sys.argv[1]), sys.argv[2:])
