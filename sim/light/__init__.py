"""Reflectance models: what light does on a surface. No hardware, no files."""
