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
sorted(truth)

# %%
# The largest force: load cell and noise make it uncertain by this much.
found = test.results.loc["peak_force.1"]
budget = test.budget("peak_force.1")
budget

# %%
# Each part of the budget as it moves the result, in N:
mpl.rcParams["axes.spines.right"] = mpl.rcParams["axes.spines.top"] = False
parts = Figure(figsize=(6.0, 2.5), layout="constrained")
axes = parts.subplots()
axes.barh(list(budget.index), budget["change"])
axes.set_xlabel("change of the peak force by one standard uncertainty (N)")
_ = axes.set_title(f"{found['value']:.1f} N, 95 %: {found['lower']:.1f} to {found['upper']:.1f} N")

# %%
# The lines that stiffnesses are read from, the break point and the failure:
lines = test.figure("stiffness-lines")
