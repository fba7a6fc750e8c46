"""Foundations without optics: errors, files that are written whole, tables, progress, caches."""
