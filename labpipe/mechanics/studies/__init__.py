"""Many results in, one record out: models of wires and bundles, calibration, comparison."""
