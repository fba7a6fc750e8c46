"""Inspection of prints with structural-colour inks: the colours of every pose, measured against the ink."""
