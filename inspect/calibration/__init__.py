"""Calibrations of a rig: measured, stored with date, validity and seal, and used by every inspection.

White reference, dark picture and stray light (``pictures``), linearity (``linearity``, ``photon_transfer``), centre of
rotation and pixel size (``rotation``), the lamp (``warm_up``).
"""
