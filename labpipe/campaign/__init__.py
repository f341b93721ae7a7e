"""Many tests: which there are, running them, grouping and reporting them."""
