"""Inspection of plastic parts with ridges: contrasts of the poses, measured against those predicted."""
