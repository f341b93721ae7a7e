"""Write result files (HDF5, summary.json) completely or not at all, and check them when read."""
