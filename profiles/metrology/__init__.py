"""Ridges measured on a height map: pitch, angles, heights, edges, roughness, burrs."""
