"""Cameras: one driver a make."""
