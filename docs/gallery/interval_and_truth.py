"""
What an interval is made of, and whether it holds
=================================================

The virtual lab knows what really happened and writes it beside the exports, in ``truth.json``.
labpipe never reads that; here it is compared with what labpipe found.
"""

import json
from pathlib import Path
from tempfile import mkdtemp

import matplotlib as mpl
from matplotlib.figure import Figure

import labpipe
from labpipe.virtual_lab import ChosenTests, TensileCampaign, simulate_campaigns

folder = Path(mkdtemp())
simulate_campaigns([ChosenTests((TensileCampaign(),), ("twist-tube-1a",))], folder)
test = labpipe.process(folder / "twist-tube-1a")
truth = json.loads((folder / "twist-tube-1a" / "truth.json").read_text(encoding="utf-8"))

# %%
# Ninety-five of a hundred intervals are to hold the truth; how often they do is counted over many
# more tests than this one.
names = {
    **{"peak_force.1": "peak_force", "energy_to_break": "energy_to_break"},
    **{"stiffness_first": "stiffness_first", "stiffness_second": "stiffness_second"},
}
found = test.results.loc[list(names), ["value", "lower", "upper", "unit"]]
found.insert(0, "truth", [truth[name] for name in names.values()])
found["holds"] = found["truth"].between(found["lower"], found["upper"])
found

# %%
# What the interval of the largest force is made of: each cause, and how far it moves the force, in
# N.
budget = test.budget("peak_force.1")
peak = found.loc["peak_force.1"]
mpl.rcParams["axes.spines.right"] = mpl.rcParams["axes.spines.top"] = False
parts = Figure(figsize=(6.0, 2.5), layout="constrained")
axes = parts.subplots()
axes.barh(list(budget.index), budget["change"])
axes.set_xlabel("change of the peak force by one standard uncertainty (N)")
_ = axes.set_title(f"{peak['value']:.1f} N, 95 %: {peak['lower']:.1f} to {peak['upper']:.1f} N")

# %%
# The lines that stiffnesses are read from, the break point and the failure:
lines = test.figure("stiffness-lines")
