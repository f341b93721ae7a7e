"""
Many tests: a table, and means of groups
========================================

Six twist tubes of two spools, pulled until they tear. ``labpipe.table`` gives a row per test and
result, ``labpipe.groups`` the means that a report shows; both are tables of pandas.
"""

from pathlib import Path
from tempfile import mkdtemp

from matplotlib.figure import Figure

import labpipe
from labpipe.campaign.executors import process_tests
from labpipe.virtual_lab import ChosenTests, TensileCampaign, simulate_campaigns

home = Path(mkdtemp())
tubes = tuple(f"twist-tube-{spool}{sample}" for spool in "12" for sample in "abc")
made = simulate_campaigns([ChosenTests((TensileCampaign(),), tubes)], home / "raw")
sheets = [folder / "test.yaml" for folder in made]
done = process_tests(sheets, out=home / "processed", figures=False)

# %%
# The peak force of each tube, with its interval, in N:
table = labpipe.table(home / "processed", by="spool")
peaks = table[table["result"] == "peak_force.1"]
peaks[["test", "spool", "value", "lower", "upper", "status"]]

# %%
# Their mean. It is over the spools where these differ, and says so:
means = labpipe.groups(home / "processed")
means[means["result"] == "peak_force.1"][["mean", "lower", "upper", "n", "tests", "how"]]

# %%
# The curves, one colour a spool:
figure = Figure(figsize=(6.0, 3.6), layout="constrained")
axes = figure.subplots()
spools = sorted(set(peaks["spool"]))
for each in sorted((home / "processed").glob("twist-tube-*")):
    test = labpipe.open(each)
    colour = f"C{spools.index(test.specimen.spool)}"
    curve = test.display.curve
    axes.plot(curve["displacement"], curve["force"], colour, linewidth=0.8)
axes.set_xlabel(f"displacement ({curve.attrs['units']['displacement']})")
_ = axes.set_ylabel(f"force ({curve.attrs['units']['force']})")
