"""Where the part stands in every picture, and where the height map lies on it.

Markers first (``markers``, ``markerfit``, ``placement``), edges where there are none (``edges``); ``placing`` chooses.
"""
