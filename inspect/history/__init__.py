"""What was inspected, when, and how it came out: rows that are only ever added, each sealed to the one before."""
