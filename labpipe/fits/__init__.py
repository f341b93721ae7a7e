"""Numbers of a curve, each with a 95 % interval: stiffness, slack, drops, failure, loops."""
