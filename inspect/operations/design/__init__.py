"""Designing surfaces: plates of ridges with the files of their mould, and etched steps."""
