"""History of inspections: append-only rows, each sealed to the one before."""
