"""Analyse signals sampled in time: filters, turning points, bad samples, rests, clocks."""
