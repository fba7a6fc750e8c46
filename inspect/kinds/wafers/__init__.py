"""Inspection of etched wafers: mirrors with steps, predicted by the diffraction orders of the tile that repeats."""
