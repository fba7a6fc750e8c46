"""Diagnosis: causes of deviations, their signatures, and their ranking for a measured part."""
