"""Inverse design of stepped surfaces with a given reflectance (Levin et al. 2013, sections 3 and 4)."""
