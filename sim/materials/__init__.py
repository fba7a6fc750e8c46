"""Inks and spectra as files."""
