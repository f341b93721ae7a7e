"""
Wires and a bundle, from dimensions alone
=========================================

The wire model takes a sheet with a row of dimensions for each wire and gives the law of its
bending. Nothing here is measured. ``labpipe model`` and ``labpipe bundle`` do the same, and write
tables.
"""

from pathlib import Path
from tempfile import mkdtemp

from matplotlib.figure import Figure

from labpipe.mechanics.studies.bundle_bounds import model_bundle
from labpipe.mechanics.studies.wire_models import tabulate_wires
from labpipe.mechanics.studies.wire_sheets import read_wire_sheet
from labpipe.protocol.load import find_shipped_folder

sheet = find_shipped_folder("examples") / "wires.xlsx"
specs = [each for each in read_wire_sheet(sheet).specs if each.name in ("A1", "A2", "B2")]
made, refused = tabulate_wires(specs, sheet)
for law, _ in made:
    print(f"{law.name}: strands that slip give {1e6 * law.slip_stiffness:.0f} N mm^2")

# %%
# How stiff a wire is depends on how far it is bent: strands stick, then slip, then yield.
figure = Figure(figsize=(6.0, 3.4), layout="constrained")
axes = figure.subplots()
for law, _ in made:
    axes.loglog(law.curvature[1:], 1e6 * law.secant_stiffness[1:], label=law.name)
axes.set_xlabel("curvature (1/m)")
axes.set_ylabel("secant bending stiffness (N mm²)")
_ = axes.legend()

# %%
# A bundle of nineteen of them lies between two bounds: all wires slip on each other, or none does.
bundle = model_bundle("19 B2", wires=sheet, out=Path(mkdtemp()), figures=False)
model = bundle.model
print(f"wires slip: {1e6 * model.low:.0f} N mm^2, wires stick: {1e6 * model.high:.0f} N mm^2")
