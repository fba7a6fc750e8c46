"""Structural-colour inks as files: inks, goniometer readings and lamps, and the fit of one to the other."""
