"""Simulation: what light does on a surface, and a virtual rig that shows it."""
