"""Process many tests: find, run, watch, query, group and report them."""
