"""Whether the tests would notice a fault: small faults are made on purpose, a seeded sample."""
