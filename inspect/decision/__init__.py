"""Verdicts: guard bands, the consistency test, reference parts."""
