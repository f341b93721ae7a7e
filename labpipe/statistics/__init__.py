"""Pure statistics of groups: means, bands, nested samples, comparison of groups."""
