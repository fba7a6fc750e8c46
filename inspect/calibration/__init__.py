"""Calibrations of a rig: measured, stored with date, validity and seal, and used by every inspection.

White reference, dark picture and stray light (``pictures``), linearity (``linearity``, ``phototransfer``), centre of
rotation and pixel size (``rotation``), the check standard (``check``), the lamp (``lampwatch``, ``warmup``).
"""
