"""Compute the statistics of groups: means of nested samples, bands, outliers, comparisons."""
