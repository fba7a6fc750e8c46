"""Structural-colour inks: their BRDF, albedo and table-based shading. No files of the user."""
