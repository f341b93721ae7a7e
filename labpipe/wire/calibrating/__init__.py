"""What calibration of the wire model is made of; `wire.calibration` is the way in."""
