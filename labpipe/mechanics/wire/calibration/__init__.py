"""Calibration of the wire model; `calibrate_wire` is the way in."""
