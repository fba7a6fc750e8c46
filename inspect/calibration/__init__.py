"""Calibrations of a rig: measured, stored with date, validity and seal, and used by every inspection.

White reference, dark picture and stray light (``pictures``), linearity and photon transfer (``linearity``), centre of
rotation and pixel size (``rotation``), the lamp (``warm_up``).
"""
