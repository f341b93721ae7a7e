"""Uncertainty of numbers: noise models, replicates of curves, intervals, and linear fits."""
