"""Plates of fields with ridges of several directions, such as codes: contrasts between fields and between poses."""
