"""Write result files (HDF5, summary.json) completely or not at all, and read them checked."""
