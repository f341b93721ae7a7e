"""How wires, bundles and harness lines bend: laws, models, calibration and texts for simulation."""
